"""One mesh of a file: other programs' PLY and OFF, in their order, with nothing changed unsaid."""

import hashlib

import meshio
import numpy as np
import pytest
import trimesh

from cageik_cli.formats.open import load_mesh
from cageik_cli.util.errors import FormatError, InputError
from tests.formats.polygons import MESH_KINDS, encode_polygons
from tests.refusals import refused
from tests.shapes import QUADS, box
from tests.texts import texts


def _by_trimesh(path, mesh):
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)


def _by_meshio(path, mesh, **options):
    meshio.Mesh(mesh.vertices, [("triangle", mesh.faces)]).write(path, **options)


def _rotated():
    """A cube whose coordinates need every digit, with two vertices at one place."""
    mesh = box(np.pi)
    vertices = np.concatenate([mesh.vertices / 3, mesh.vertices[:1] / 3])
    return type(mesh)(vertices, np.concatenate([mesh.faces, [[8, 1, 2]]]))


@pytest.mark.parametrize(
    ("name", "write", "rtol"),
    [
        ("ascii.ply", lambda p, m: _by_meshio(p, m, binary=False), 1e-15),
        ("binary.ply", lambda p, m: _by_meshio(p, m, binary=True), 0),
        ("single.ply", _by_trimesh, 1e-6),
        ("trimesh.off", _by_trimesh, 1e-7),
        ("CAPITALS.PLY", lambda p, m: _by_trimesh(p.with_suffix(".ply"), m), 1e-6),
        ("trimesh.obj", _by_trimesh, 1e-7),
        ("meshio.obj", lambda p, m: _by_meshio(p, m), 1e-6),
    ],
)
def test_files_of_other_programs_keep_every_vertex_in_its_place(tmp_path, name, write, rtol):
    mesh, path = _rotated(), tmp_path / name
    write(path, mesh)
    if not path.exists():
        path.with_suffix(path.suffix.lower()).rename(path)
    loaded = load_mesh(path)
    np.testing.assert_allclose(loaded.mesh.vertices, mesh.vertices, rtol=rtol, atol=0)
    np.testing.assert_array_equal(loaded.mesh.faces, mesh.faces)
    assert texts(loaded.notes) == ()
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert loaded.source == {"name": name, "sha256": digest}


@pytest.mark.parametrize("kind", MESH_KINDS)
def test_polygons_are_cut_and_said_so(tmp_path, kind):
    path, mesh = tmp_path / f"quads.{kind}", box()
    path.write_bytes(encode_polygons(kind, mesh.vertices, QUADS))
    loaded = load_mesh(path)
    assert loaded.mesh.is_closed
    assert loaded.mesh.volume == pytest.approx(8)
    assert texts(loaded.notes) == ("6 polygons cut into triangles to compute with",)


PENTAGON = np.array([[0, 0, 0], [2, 0, 0], [3, 1, 0], [0.5, 1, 0], [0, 2, 0]])


@pytest.mark.parametrize("kind", MESH_KINDS)
@pytest.mark.parametrize("behind", [[], [[0, 1, 2]], [[4, 3, 1, 0]]])
def test_a_concave_polygon_is_cut_without_folding_and_counted_once(tmp_path, kind, behind):
    """In files of one kind of polygon, and of several; in the order of the file."""
    path = tmp_path / f"polygons.{kind}"
    path.write_bytes(encode_polygons(kind, PENTAGON, [[1, 2, 3, 4, 0], *behind]))
    loaded = load_mesh(path)
    count = 1 + (len(behind) > 0 and len(behind[0]) > 3)
    assert texts(loaded.notes) == (
        f"{count} polygon{'s' * (count > 1)} cut into triangles to compute with",
    )
    x, y = PENTAGON[:, :2].T
    area = (x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
    a, b, c = (loaded.mesh.vertices[corner] for corner in loaded.mesh.faces[:3].T)
    areas = np.cross(b - a, c - a)[:, 2] / 2
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(area, rel=1e-7)
    assert len(loaded.mesh.faces) == 3 + sum(len(p) - 2 for p in behind)


def test_a_signalling_nan_is_refused_without_a_warning(tmp_path):
    path, points = tmp_path / "snan.ply", PENTAGON.astype("<f4")
    points.view("<u4")[2, 0] = 0x7FA00000
    path.write_bytes(encode_polygons("binary.ply", points, [range(5)]))
    with pytest.raises(FormatError, match="vertex 2 is \\(nan, 1, 0\\)"):
        load_mesh(path)


OFF = "OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n"


@pytest.mark.parametrize(
    "text",
    [
        OFF.replace("OFF\n", "OFF "),
        OFF.replace("OFF\n", "OFF\n# a comment\n"),
        OFF.replace("\n", "\r\n"),
        OFF.replace("4 2 0\n", "4 2\n"),
        OFF.replace("OFF\n", "COFF "),
        OFF.replace("1 2\n", "1 2 255 0 0\n"),
        OFF.replace("OFF", "COFF").replace(" 0\n", " 0 9 9 9 9\n").replace("2 0 9 9 9 9", "2 0"),
        OFF.replace("3 0 1 2", "\n  3 0 1 2  # a comment\n"),
    ],
)
def test_dialects_of_off(tmp_path, text):
    path = tmp_path / "square.off"
    path.write_text(text, newline="")
    mesh = load_mesh(path).mesh
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [0, 2, 3]])


PLY = """ply
format ascii 1.0
comment TextureFile skin.png
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
property list uchar float texcoord
end_header
0 0 0
1 0 0
1 1 0
0 1 0
3 0 1 2 6 0 0 1 0 1 1
3 0 2 3 6 .5 0 .6 0 .7 0
"""


def test_texture_seams_of_a_ply_split_no_vertex(tmp_path):
    path = tmp_path / "textured.ply"
    path.write_text(PLY)
    assert len(load_mesh(path).mesh.vertices) == 4


FAULTS = {
    "missing.obj": (None, "no such file"),
    "folder.obj": ("folder", "folder"),
    "mesh.step": (b"solid", ".step"),
    "mesh": (b"", "expected .abc, "),
    "empty.obj": (b"", "empty"),
    "empty.ply": (b"", "empty"),
    "empty.off": (b"", "empty"),
    "text.ply": (b"hello", "PLY"),
    "text.off": (b"hello", "OFF"),
    "short.off": (OFF[:30].encode(), "OFF"),
    "short.ply": (PLY[:250].encode(), "PLY"),
    "nan.off": (OFF.replace("1 1 0", "1 nan 0").encode(), "vertex 2 is (1, nan, 0)"),
    "huge.off": (OFF.replace("3 0 2 3", f"3 0 2 {10**30}").encode(), "OFF"),
    "two.off": (OFF.replace("3 0 2 3", "2 0 2").encode(), "face 1 has 2 corners"),
    "lacking.off": (OFF.replace("3 0 2 3", "3 0 2").encode(), "3 0 2"),
    "uneven.off": (OFF.replace("1 1 0", "1 1").encode(), "OFF"),
    "counts.off": (b"OFF\n4\n", "OFF"),
    "bare.off": (b"OFF", "OFF"),
    "binary.off": (b"OFF BINARY\n\0\0\0\4", "OFF"),
    "ends.off": (OFF[:-8].encode(), "announces 4 vertices and 2 faces, but holds 4 and 1"),
    "beyond.off": (OFF.replace("3 0 2 3", "3 0 2 9").encode(), "vertices"),
}


@pytest.mark.parametrize(("name", "content", "says"), [(n, *f) for n, f in FAULTS.items()])
def test_what_is_no_mesh_is_refused(tmp_path, name, content, says):
    path = tmp_path / name
    if content == "folder":
        path.mkdir()
    elif content is not None:
        path.write_bytes(content)
    with refused(InputError, says, at=path):
        load_mesh(path)


@pytest.mark.parametrize("kind", MESH_KINDS)
def test_a_point_cloud_is_called_one(tmp_path, kind):
    path = tmp_path / f"a.{kind}"
    path.write_bytes(encode_polygons(kind, np.eye(3), []))
    if kind == "binary.ply":  # without an element for faces
        path.write_bytes(trimesh.PointCloud(np.eye(3)).export(file_type="ply"))
    with refused(FormatError, "is a point cloud: 3 points and no faces, ", at=path):
        load_mesh(path)
