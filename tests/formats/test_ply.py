"""PLY: every layout gives its mesh, damage a sentence, and surfaces come back as they were."""

from contextlib import suppress
from dataclasses import replace

import meshio
import numpy as np
import pytest
import trimesh
from hypothesis import example, given
from hypothesis import strategies as st

from cageik_cli.formats.open import load_mesh
from cageik_cli.formats.ply import PlyFrameParser, Reader
from cageik_cli.formats.write import write_mesh
from cageik_cli.geometry.attributes import UvMap
from cageik_cli.util.errors import FormatError, InputError
from tests.assets import asset_text, parse_asset
from tests.refusals import refused
from tests.shapes import quad_text
from tests.surfaces import ASSET, assert_same, change, read_obj


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
    "vertex lists": (ply().replace(b"float y", b"list float float y"), "has the invalid line"),
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


TEXT = parse_asset(asset_text())
COLOURS = np.rint(np.linspace(0, 255, 90)).reshape(30, 3) / 255


def write(path, mesh):
    write_mesh(path, mesh, mesh.vertices, overwrite=False)
    return path


def test_meshio_reads_polygons_of_several_sizes(tmp_path):
    other = meshio.read(write(tmp_path / "a.ply", change(ASSET, uvs=None, colours=COLOURS)))
    np.testing.assert_array_equal(other.points, ASSET.vertices)
    quads = [polygon for polygon in TEXT.polygons if len(polygon) == 4]
    np.testing.assert_array_equal(other.cells_dict["quad"], quads)
    colours = np.column_stack([other.point_data[name] for name in ("red", "green", "blue")])
    np.testing.assert_array_equal(colours.astype(np.uint8), np.rint(255 * COLOURS))
    normals = np.column_stack([other.point_data[name] for name in ("nx", "ny", "nz")])
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-6)
    # Vertices of the side away from the caps have one normal, which is radial.
    inner = ASSET.vertices[5:25] * [1, 1, 0]
    radial = inner / np.linalg.norm(inner, axis=1, keepdims=True)
    np.testing.assert_allclose(normals[5:25], radial, atol=1e-6)


def test_trimesh_reads_quads_with_colours(tmp_path):
    box = read_obj(quad_text(1.0))
    mesh = change(box, uvs=None, colours=COLOURS[:8])
    loaded = trimesh.load(write(tmp_path / "a.ply", mesh), process=False, maintain_order=True)
    np.testing.assert_array_equal(loaded.vertices, box.vertices)
    np.testing.assert_array_equal(loaded.visual.vertex_colors[:, :3], np.rint(255 * COLOURS[:8]))
    assert loaded.volume == pytest.approx(box.volume, rel=1e-12)


def test_corners_without_uvs(tmp_path):
    """A face of them has no list; one corner alone cannot be said in PLY."""
    indices = ASSET.attributes.uvs.indices.copy()
    indices[4:8] = -1
    mesh = change(ASSET, uvs=replace(ASSET.attributes.uvs, indices=indices))
    uvs = load_mesh(write(tmp_path / "a.ply", mesh)).mesh.attributes.uvs
    np.testing.assert_array_equal(np.flatnonzero(uvs.indices < 0), [4, 5, 6, 7])


def test_faces_of_many_corners(tmp_path):
    angles = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    points = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    text = "".join("v {} {} {}\n".format(*point) for point in points)
    text += "vt 0 0\nvt 0 1\nf " + " ".join(f"{k}/{k % 2 + 1}" for k in range(1, 301)) + "\n"
    mesh = read_obj(text)
    read = load_mesh(write(tmp_path / "a.ply", mesh)).mesh.attributes
    np.testing.assert_array_equal(read.corners, np.arange(300))
    assert_same(read.uvs, UvMap(np.array([[0, 0.0], [0, 1]]), (np.arange(300) + 1) % 2))


HEADER = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
{}element face 2
property list uchar int vertex_indices
{}end_header
"""


def make_text(vertex="", numbers="", face="", lists=("", "")):
    properties = "".join(f"property float {name}\n" for name in vertex.split())
    rows = [f"{x} {y} 0 {numbers}" for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    faces = [f"3 0 1 2 {lists[0]}", f"3 0 2 3 {lists[1]}"]
    return HEADER.format(properties, face) + "\n".join([*rows, *faces]) + "\n"


TEXCOORD = "property list uchar float texcoord\n"


def read_text(text):
    return Reader.read_attributes(text.encode(), Reader.parse(text.encode()))


@pytest.mark.parametrize("names", ["s t", "u v", "texture_u texture_v"])
def test_uvs_of_vertices_in_a_text(names):
    attributes = read_text(make_text(names, "0.5 0.25")).attributes
    assert attributes.uvs.values.tolist() == [[0.5, 0.25]] * 4
    assert attributes.uvs.indices.tolist() == [0, 1, 2, 0, 2, 3]


def test_a_text_with_all():
    lists = ("6 0 0 1 0 1 1", "6 0 0 1 1 0 1")
    text = make_text("nx ny nz red green blue alpha", "0 0 1 1 0.5 0 1", TEXCOORD, lists)
    attributes = read_text(text).attributes
    assert attributes.colours.tolist() == [[1, 0.5, 0, 1]] * 4
    assert attributes.normal_fans.tolist() == [0, 1, 2, 0, 2, 3]
    assert attributes.uvs.indices.tolist() == [0, 2, 3, 0, 3, 1]


def test_a_text_that_says_nothing_more_has_no_attributes():
    assert read_text(make_text()).make_mesh().attributes is None


LEFT_OUT = {
    "infinite UVs": (make_text("s t", "inf 0"), "texture coordinates left out"),
    "UVs beyond their type": (
        make_text(face=TEXCOORD, lists=["6 1e99 0 1 0 1 1"] * 2),
        "texture coordinates left out",
    ),
    "infinite colours": (make_text("red green blue", "1 nan 0"), "colours left out"),
}


@pytest.mark.parametrize(("text", "says"), LEFT_OUT.values(), ids=LEFT_OUT)
def test_what_is_damaged_is_left_out_and_said_so(text, says):
    mesh = read_text(text)
    assert mesh.make_mesh().attributes is None
    assert says in str(mesh.left_out[0])


def test_lists_that_do_not_fit_are_left_out_and_said_so():
    text = make_text(face=TEXCOORD, lists=("6 0 0 1 0 1 1", "4 0 0 1 1")).encode()
    found = Reader.read_attributes(text, Reader.parse(text))
    assert found.attributes.uvs is None
    assert "texture coordinates left out" in str(found.left_out[0])


def test_a_binary_file_cut_behind_its_faces_is_left_as_it_is(tmp_path):
    """The lists of texture coordinates are read behind the faces that the mesh needs."""
    path = write(tmp_path / "a.ply", ASSET)
    data = path.read_bytes().replace(
        b"property list uchar float texcoord", b"property list int float texcoord", 1
    )
    mesh = Reader.parse(path.read_bytes())
    found = Reader.read_attributes(data, mesh)
    assert "left out" in str(found.left_out[0])


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_a_face_of_too_few_corners_is_named(tmp_path, encoding):
    mesh = trimesh.creation.box()
    data = mesh.export(file_type="ply", encoding=encoding)
    old, new = (b"\n3 1 3 0", b"\n2 1 3") if encoding == "ascii" else (b"\3\1\0", b"\0\1\0")
    assert old in data
    (tmp_path / "box.ply").write_bytes(data.replace(old, new, 1))
    with pytest.raises(FormatError, match=r"face 0 has . corners, expected 3 or more; export it"):
        load_mesh(tmp_path / "box.ply")
