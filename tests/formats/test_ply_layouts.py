"""PLY with strips of triangles, and with lists among the properties of vertices."""

import struct

import numpy as np
import pytest
import trimesh

from cageik_cli.formats import ply
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.ply import Reader, cut_strips
from cageik_cli.formats.ply_points import parse_points
from cageik_cli.util.errors import FormatError
from tests.refusals import refused
from tests.shapes import QUADS, box

BOX = box()
NUMBERS = {"i4": "int", "u4": "uint", "i2": "short"}
QUAD_LISTS = [list(quad) for quad in QUADS]


def join(strips, end=-1):
    return [number for strip in strips for number in [*strip, end]]


CORNERS = [[a, b, d, c] for a, b, c, d in QUADS]
"""Each quad as a strip of two triangles."""


def make(form="ascii", lists=(CORNERS,), code="i4", neighbours=None, faces=()):
    """A box: strips, one row per list; vertices may have a list, before z or behind."""
    order = ">" if form == "binary_big_endian" else "<"
    near = [] if neighbours is None else ["property list uchar int near"]
    head = [
        *("ply", f"format {form} 1.0", f"element vertex {len(BOX.vertices)}", "property float x"),
        *("property float y", *near, "property double z", "property uchar red"),
        *("property uchar green", "property uchar blue"),
    ]
    elements = []
    if lists is not None:
        kind = ["element tristrips", len(lists), "property list int", NUMBERS[code]]
        end = 2**32 - 1 if code == "u4" else -1
        elements.append((kind, [join(strips, end) for strips in lists], code))
    if faces:
        elements.append((["element face", len(faces), "property list int", "int"], faces, "i4"))
    rows = []
    for k, (x, y, z) in enumerate(BOX.vertices.tolist()):
        held = [] if neighbours is None else neighbours[k % len(neighbours)]
        if form == "ascii":
            words = [x, y, *([len(held), *held] if near else []), z, k, 0, 9]
            rows.append((" ".join(map(str, words)) + "\n").encode())
            continue
        row = np.array([x, y], f"{order}f4").tobytes()
        if near:
            row += bytes([len(held)]) + np.array(held, f"{order}i4").tobytes()
        rows.append(row + np.array(z, f"{order}f8").tobytes() + bytes([k, 0, 9]))
    body = []
    for (word, count, kind, number), found, letter in elements:
        head += [f"{word} {count}", f"{kind} {number} vertex_indices"]
        for numbers in found:
            if form == "ascii":
                body.append(f"{len(numbers)} {' '.join(map(str, numbers))}\n".encode())
            else:
                body.append(np.array(len(numbers), f"{order}i4").tobytes())
                body.append(np.array(numbers, f"{order}{letter}").tobytes())
    return "\n".join([*head, "end_header", ""]).encode() + b"".join(rows + body)


FORMS = ["ascii", "binary_little_endian", "binary_big_endian"]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("code", NUMBERS)
@pytest.mark.parametrize(
    "lists", [[CORNERS], [CORNERS[:2], CORNERS[2:]], [[each] for each in CORNERS]]
)
def test_strips_are_the_triangles_of_the_box(tmp_path, form, code, lists):
    path = tmp_path / "strips.ply"
    path.write_bytes(make(form, lists, code))
    mesh = open_sequence([str(path)]).first
    assert len(mesh.faces) == 12
    assert mesh.is_closed
    assert mesh.volume == pytest.approx(BOX.volume)
    assert mesh.attributes.colours is not None
    assert parse_points(path.read_bytes()) is None


def test_every_second_triangle_is_turned_from_the_beginning_of_each_strip():
    corners, sizes = cut_strips(np.array([0, 1, 2, 3, 4, -1, 5, 6, 7, 8]), np.array([10]))
    expected = [[0, 1, 2], [2, 1, 3], [2, 3, 4], [5, 6, 7], [7, 6, 8]]
    np.testing.assert_array_equal(corners.reshape(-1, 3), expected)
    assert sizes.tolist() == [3] * 5


@pytest.mark.parametrize(
    "numbers", [[], [-1], [0, 1], [0, -1, 1, 2, -1, 3], [0, 0, 1, -1, 2, 2, 2, 2]]
)
def test_strips_without_triangles_have_none(numbers):
    corners, sizes = cut_strips(np.array(numbers, np.int64), np.array([len(numbers)]))
    assert (len(corners), len(sizes)) == (0, 0)


def test_strips_that_are_joined_by_equal_corners_are_cut():
    corners, _ = cut_strips(np.array([0, 1, 2, 3, 3, 4, 4, 5, 6]), np.array([9]))
    expected = [[0, 1, 2], [2, 1, 3], [4, 5, 6]]
    np.testing.assert_array_equal(corners.reshape(-1, 3), expected)


@pytest.mark.parametrize("form", FORMS)
def test_strips_and_faces_are_one_surface(form):
    mesh = Reader.parse(make(form, [CORNERS[:3]], faces=[list(quad) for quad in QUADS[3:]]))
    assert sorted(mesh.corner_counts.tolist()) == [3] * 6 + [4] * 3
    whole = mesh.make_mesh()
    assert whole.is_closed
    assert whole.volume == pytest.approx(BOX.volume)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("neighbours", [[[1, 2]], [[], [1], [2, 3, 4]], [[]]])
def test_lists_among_the_properties_of_vertices_are_passed_over(tmp_path, form, neighbours):
    path = tmp_path / "lists.ply"
    path.write_bytes(make(form, None, neighbours=neighbours, faces=QUAD_LISTS))
    mesh = open_sequence([str(path)]).first
    np.testing.assert_allclose(mesh.vertices, BOX.vertices)
    assert mesh.volume == pytest.approx(BOX.volume)
    colours = mesh.attributes.colours * 255
    np.testing.assert_allclose(colours[:, 0], np.arange(8))


def test_trimesh_reads_the_same(tmp_path):
    path = tmp_path / "a.ply"
    path.write_bytes(make("binary_little_endian", None, neighbours=[[1, 2]], faces=QUAD_LISTS))
    mesh = open_sequence([str(path)]).first
    with np.errstate(all="ignore"):
        other = trimesh.load(path, process=False)
    np.testing.assert_allclose(np.asarray(other.vertices), mesh.vertices)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("cut", [1, 9, 40, 150])
def test_what_is_cut_short_is_refused(form, cut):
    for data in (make(form, None, neighbours=[[], [1], [2, 3, 4]], faces=QUAD_LISTS), make(form)):
        short = data[:-cut].rsplit(b"\n", 1)[0] if form == "ascii" else data[:-cut]
        with refused(FormatError, "is not a sound PLY mesh"):
            Reader.parse(short)


def test_many_lists_are_measured_in_one_walk(tmp_path, monkeypatch):
    """Each list has its size in the first row; 107 kB of 3000 lists took a row each: seconds."""
    count, calls = 300, []
    head = ["ply", "format binary_little_endian 1.0", "element vertex 8"]
    head += [f"property float {axis}" for axis in "xyz"]
    head += [f"property list uchar uchar p{k}" for k in range(count)]
    head += ["element face 12", "property list uchar int vertex_indices", "end_header"]
    vertices = np.asarray(BOX.vertices, "<f4")
    path = tmp_path / "lists.ply"
    path.write_bytes(
        "\n".join([*head, ""]).encode()
        + b"".join(row.tobytes() + bytes(count) for row in vertices)
        + b"".join(b"\3" + row.tobytes() for row in np.asarray(BOX.faces, "<i4"))
    )
    calculate = struct.calcsize
    monkeypatch.setattr(ply.struct, "calcsize", lambda code: calls.append(1) or calculate(code))
    mesh = open_sequence([str(path)]).first
    np.testing.assert_array_equal(mesh.vertices, vertices)
    np.testing.assert_array_equal(mesh.faces, BOX.faces)
    assert count < len(calls) < 20 * count


@pytest.mark.parametrize(("size", "says"), [(-1, "a list of -1 items"), (100, "cut short")])
def test_a_list_of_the_first_row_that_cannot_be_is_refused(tmp_path, size, says):
    head = ["ply", "format binary_little_endian 1.0", "element vertex 8"]
    head += ["property float x", "property list char int near", "property float y"]
    head += ["property float z", "element face 0", "property list uchar int vertex_indices"]
    row = struct.pack("<fbff", 0, size, 0, 0)
    path = tmp_path / "lists.ply"
    path.write_bytes("\n".join([*head, "end_header", ""]).encode() + 8 * row)
    with refused(FormatError, says, path):
        open_sequence([str(path)])
