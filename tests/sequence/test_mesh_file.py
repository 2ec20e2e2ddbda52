"""One mesh of a file: other programs' PLY and OFF, in their order, with nothing changed unsaid."""

import hashlib

import meshio
import numpy as np
import pytest
import trimesh

from cageik_cli.errors import InputError
from cageik_cli.sequence import load_mesh
from tests.shapes import box

QUADS = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
)


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
    assert loaded.notes == ()
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert loaded.source == {"name": name, "sha256": digest}


@pytest.mark.parametrize("kind", ["obj", "ply", "off"])
def test_polygons_are_cut_and_said_so(tmp_path, write_obj, kind):
    path, mesh = tmp_path / f"quads.{kind}", box()
    if kind == "obj":
        write_obj(path, mesh.vertices, QUADS)
    elif kind == "ply":
        meshio.Mesh(mesh.vertices, [("quad", QUADS)]).write(path)
    else:
        faces = "".join(f"4 {a} {b} {c} {d}\n" for a, b, c, d in QUADS)
        points = "".join("{} {} {}\n".format(*vertex) for vertex in mesh.vertices)
        path.write_text(f"OFF\n8 6 0\n{points}{faces}")
    loaded = load_mesh(path)
    assert loaded.mesh.is_closed
    assert loaded.mesh.volume == pytest.approx(8)
    assert loaded.notes == ("6 polygons cut into triangles",)


OFF = "OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n"


@pytest.mark.parametrize(
    "text",
    [
        OFF.replace("OFF\n", "OFF "),
        OFF.replace("OFF\n", "OFF\n# a comment\n"),
        OFF.replace("\n", "\r\n"),
        OFF.replace("1 2\n", "1 2 255 0 0\n"),
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
    "missing.obj": (None, "cannot be read: No such file"),
    "folder.obj": ("folder", "is a folder, expected a file"),
    "mesh.stl": (b"solid", "`.stl` is not a kind of mesh read here, expected .obj, .ply, .off"),
    "mesh": (b"", "`` is not a kind of mesh read here"),
    "empty.obj": (b"", "the file is empty"),
    "empty.ply": (b"", "the file is empty"),
    "empty.off": (b"", "the file is empty"),
    "text.ply": (b"hello", "no PLY mesh can be read from it"),
    "text.off": (b"hello", "no OFF mesh can be read from it"),
    "short.off": (OFF[:30].encode(), "no OFF mesh can be read from it"),
    "short.ply": (PLY[:250].encode(), "no PLY mesh can be read from it"),
    "points.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        b"property float z\nend_header\n0 0 0\n",
        "expected (count, 3)",
    ),
    "nan.off": (OFF.replace("1 1 0", "1 nan 0").encode(), "vertex 2 is (1, nan, 0)"),
    "beyond.off": (OFF.replace("3 0 2 3", "3 0 2 9").encode(), "vertices"),
}


@pytest.mark.parametrize(("name", "content", "says"), [(n, *f) for n, f in FAULTS.items()])
def test_what_is_no_mesh_is_refused(tmp_path, name, content, says):
    path = tmp_path / name
    if content == "folder":
        path.mkdir()
    elif content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        load_mesh(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert says in str(caught.value)


def test_an_off_file_that_ends_inside_its_faces_is_refused(tmp_path):
    path = tmp_path / "short.off"
    path.write_text(OFF[:-4])
    with pytest.raises(InputError):
        load_mesh(path)
