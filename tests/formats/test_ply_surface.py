"""Surfaces in PLY: read by other programs, and read back as they were."""

from dataclasses import replace

import meshio
import numpy as np
import pytest
import trimesh

from cageik_cli.formats.open import load_mesh
from cageik_cli.formats.ply import Reader
from cageik_cli.formats.write import write_mesh
from cageik_cli.geometry.attributes import UvMap
from cageik_cli.util.errors import FormatError
from tests.assets import asset_text, parse_asset
from tests.shapes import quad_text
from tests.surfaces import ASSET, assert_same, change, read_obj

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
    assert says in mesh.left_out[0]


def test_lists_that_do_not_fit_are_left_out_and_said_so():
    text = make_text(face=TEXCOORD, lists=("6 0 0 1 0 1 1", "4 0 0 1 1")).encode()
    found = Reader.read_attributes(text, Reader.parse(text))
    assert found.attributes.uvs is None
    assert "texture coordinates left out" in found.left_out[0]


def test_a_binary_file_cut_behind_its_faces_is_left_as_it_is(tmp_path):
    """The lists of texture coordinates are read behind the faces that the mesh needs."""
    path = write(tmp_path / "a.ply", ASSET)
    data = path.read_bytes().replace(
        b"property list uchar float texcoord", b"property list int float texcoord", 1
    )
    mesh = Reader.parse(path.read_bytes())
    found = Reader.read_attributes(data, mesh)
    assert "left out" in found.left_out[0]


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_a_face_of_too_few_corners_is_named(tmp_path, encoding):
    mesh = trimesh.creation.box()
    data = mesh.export(file_type="ply", encoding=encoding)
    old, new = (b"\n3 1 3 0", b"\n2 1 3") if encoding == "ascii" else (b"\3\1\0", b"\0\1\0")
    assert old in data
    (tmp_path / "box.ply").write_bytes(data.replace(old, new, 1))
    with pytest.raises(FormatError, match=r"face 0 has . corners, expected 3 or more; export it"):
        load_mesh(tmp_path / "box.ply")
