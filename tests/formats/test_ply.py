"""Binary PLY: every layout gives its mesh, and whatever is damaged a sentence."""

from contextlib import suppress

import meshio
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cageik_cli.formats.ply import PlyFrameParser, Reader
from cageik_cli.util.errors import FormatError, InputError
from tests.refusals import refused


def parse(data):
    """The vertices, the corners of all faces in order, and how many each has."""
    mesh = Reader.parse(data)
    return mesh.vertices, mesh.corners, mesh.corner_counts


VERTICES = np.array([[0, 0, 0], [2, 0, 0], [3, 1, 0], [0.5, 1, 0], [0, 2, 0.25]])
POLYGONS = [[0, 1, 2, 3], [0, 1, 2], [0, 1, 2, 3, 4]]


def ply(order="<", count="B", index="i4", polygons=POLYGONS, other=b"", behind=b""):
    """A file whose vertices have a colour before z, and whose faces have a flag behind the list."""
    names = {"<": "little", ">": "big", "B": "uchar", "i2": "short", "i4": "int", "u4": "uint32"}
    header = (
        f"ply\nformat binary_{names[order]}_endian 1.0\ncomment made by hand\n"
        "element vertex 5\nproperty double x\nproperty float y\nproperty uchar red\n"
        f"property float32 z\n{other.decode()}element face {len(polygons)}\n"
        f"property list {names[count]} {names[index]} vertex_index\n"
        "property short flag\nend_header\n"
    )
    rows = np.zeros(5, [("x", f"{order}f8"), ("y", f"{order}f4"), ("r", "u1"), ("z", f"{order}f4")])
    rows["x"], rows["y"], rows["z"] = VERTICES.T
    faces = [
        np.array(len(p), order + count).tobytes() + np.array(p, order + index).tobytes() + b"\1\2"
        for p in polygons
    ]
    return header.encode() + rows.tobytes() + behind + b"".join(faces)


def text(end="\n", polygons=POLYGONS):
    """The same mesh as a text."""
    head = ply(polygons=polygons).split(b"end_header")[0].decode()
    head = head.replace("binary_little_endian", "ascii") + "end_header"
    vertices = [f"{x} {y} 0 {z}" for x, y, z in VERTICES.tolist()]
    faces = [f"{len(ring)} {' '.join(map(str, ring))} -1" for ring in polygons]
    return end.join([*head.splitlines(), *vertices, "", *faces]).encode()


OTHER = b"element strip 2\nproperty float a\nproperty list uchar short b\n"
STRIPS = b"\0\0\0\0\2\1\0\2\0" + b"\0\0\0\0\0"


@pytest.mark.parametrize(
    "data",
    [
        ply(),
        ply(">"),
        ply("<", "B", "i2"),
        ply("<", "i4", "u4"),
        ply(other=OTHER, behind=STRIPS),
        ply().replace(b"made by hand\n", b"made by hand\r\n"),
        ply() + b"element of which nothing is said",
        text(),
        text("\r\n") + b"\nwhat comes behind",
    ],
)
def test_polygons_of_several_sizes_keep_their_order(data):
    vertices, corners, sizes = parse(data)
    np.testing.assert_array_equal(vertices, VERTICES)
    assert corners.tolist() == [0, 1, 2, 3, 0, 1, 2, 0, 1, 2, 3, 4]
    assert sizes.tolist() == [4, 3, 5]


def test_uneven_polygons_as_long_as_even_ones_are_not_misread():
    """A quad, a triangle and a pentagon take the bytes of three quads."""
    data = ply()
    assert len(data) == len(ply(polygons=[[0, 1, 2, 3]] * 3))
    assert parse(data)[2].tolist() == [4, 3, 5]


def test_triangles_and_quads_by_meshio(tmp_path):
    path = tmp_path / "mixed.ply"
    cells = [("triangle", np.array([[0, 1, 2]])), ("quad", np.array([[0, 2, 3, 4]]))]
    meshio.Mesh(VERTICES, cells).write(path, binary=True)
    vertices, corners, sizes = parse(path.read_bytes())
    np.testing.assert_array_equal(vertices, VERTICES)
    assert (corners.tolist(), sizes.tolist()) == ([0, 1, 2, 0, 2, 3, 4], [3, 4])


def test_a_frame_is_read_by_its_vertices_alone():
    first, place = ply(), ply().index(b"end_header\n") + 11
    parser = PlyFrameParser(first)
    moved = first[:place] + np.array(9.5, "<f8").tobytes() + first[place + 8 :]
    expected = VERTICES.copy()
    expected[0, 0] = 9.5
    np.testing.assert_array_equal(parser.parse_positions(moved), expected)
    assert parser.parse_positions(ply(polygons=POLYGONS[::-1])) is None
    assert parser.parse_positions(ply(">")) is None
    assert parser.parse_positions(first[:-1]) is None
    assert parser.parse_positions(b"") is None
    assert PlyFrameParser(text()).parse_positions(text()) is None


FAULTS = {
    "cut inside the faces": (ply()[:-3], "PLY"),
    "text that lacks a face": (text().rpartition(b"\n")[0], "cut short"),
    "text that lacks a corner": (text()[:-5], "list of 5 items"),
    "text of words": (text().replace(b"0.25", b"o.25"), "PLY"),
    "text with more numbers": (
        text().replace(b"0.25", b"0.25 7"),
        "of `vertex` has 5 numbers, expected 4",
    ),
    "text with half a corner": (text().replace(b"1 2 -1", b"1 2.5 -1"), "PLY"),
    "element without a count": (text().replace(b"face 3", b"face"), "line `element face`"),
    "text of a negative list": (text().replace(b"3 0 1", b"-3 0 1"), "list of -3 items"),
    "text of an index beyond its type": (text().replace(b"3 0 1", b"3 0 4294967297"), "4294967297"),
    "cut in the last flag": (ply()[:-1], "PLY"),
    "cut inside the vertices": (ply()[:250], "PLY"),
    "no end of the header": (b"ply\nformat binary_little_endian 1.0\n", "no PLY header"),
    "middle endian": (ply().replace(b"little", b"middle"), "unknown word `binary_middle_endian`"),
    "type": (ply().replace(b"short flag", b"shirt flag"), "unknown word `shirt`"),
    "count": (ply().replace(b"vertex 5", b"vertex -1"), "not a valid count"),
    "claim": (ply().replace(b"vertex 5", b"vertex 5" + b"0" * 40), "PLY"),
    "more faces than bytes": (ply().replace(b"face 3", b"face 300000000000"), "PLY"),
    "no x": (ply().replace(b"double x", b"double w"), "PLY"),
    "two x": (ply().replace(b"float y", b"float x"), "invalid line `property float x`"),
    "float count": (ply().replace(b"list uchar", b"list float"), "invalid line `property list"),
    "float corners": (ply().replace(b"uchar int", b"uchar float"), "not whole"),
    "no list": (ply().replace(b"list uchar int", b"uchar"), "no list"),
    "no vertices": (ply().replace(b"t vertex", b"t vortex"), "it has no vertices"),
    "vertex lists": (ply().replace(b"uchar red", b"list uchar uchar red"), "it has no vertices"),
    "negative list": (
        ply("<", "B").replace(b"list uchar", b"list char").replace(b"\4\0\0\0\0", b"\xfc\0\0\0\0"),
        "a list of -4 items",
    ),
}


@pytest.mark.parametrize(("data", "says"), FAULTS.values(), ids=FAULTS)
def test_faults_have_a_sentence(data, says):
    with refused(FormatError, says):
        parse(data)


def test_a_text_cut_in_any_row_has_a_sentence():
    lines = text().splitlines()
    for number, line in enumerate(lines):
        words = line.split()
        for count in range(len(words)):
            cut = [*lines[:number], b" ".join(words[:count]), *lines[number + 1 :]]
            data = b"\n".join(cut)
            with suppress(FormatError):
                Reader.read_attributes(data, Reader.parse(data))
                PlyFrameParser(data)


@given(st.integers(0, len(ply())), st.integers(0, 5), st.binary(max_size=5))
@example(0, 0, b"")
def test_whatever_is_damaged_is_refused_or_read_alike(place, removed, inserted):
    data = ply()[:place] + inserted + ply()[place + removed :]
    fast = PlyFrameParser(ply()).parse_positions(data)
    try:
        vertices, _, _ = parse(data)
    except InputError:
        assert fast is None
    else:
        assert fast is None or fast.tobytes() == vertices.tobytes()
