"""What the user types becomes frames: every file once, in natural order, of one kind."""

import hashlib
from pathlib import Path

import meshio
import numpy as np
import pytest
import trimesh

from cageik_cli.formats.base.choose_parts import check_part_order
from cageik_cli.formats.find_files import expand_arguments, list_input_files
from cageik_cli.formats.open import describe_contents, load_mesh, open_clip_and_rest, open_sequence
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.geometry.parts import list_part_names
from cageik_cli.util.errors import (
    ConnectivityError,
    FileAccessError,
    FormatError,
    InputError,
    SettingError,
)
from tests.clips import frames_of
from tests.formats.polygons import MESH_KINDS, encode_polygons
from tests.refusals import refused
from tests.shapes import QUADS, box, octahedron
from tests.texts import texts

WALKS = ["walk.bvh", "walk.C3D", "walk.fbx", "walk.mb", "walk.3mf", "walk.DAE", "walk.step"]
NUMBERS = ["frame_1.obj", "frame_2.obj", "frame_10.obj", "frame_11.obj"]


@pytest.fixture
def frames(tmp_path, monkeypatch, animation, write_obj):
    """The current folder, with four frames in `frames`."""
    for name in NUMBERS:
        write_obj(tmp_path / "frames" / name, animation.rest.vertices, animation.rest.faces)
    monkeypatch.chdir(tmp_path)
    return tmp_path / "frames"


@pytest.mark.parametrize(
    "arguments",
    [
        ["frames"],
        ["frames/"],
        ["./frames"],
        ["frames/*.obj"],
        ["frames/frame_?.obj", "frames/frame_??.obj"],
        ["**/*.obj"],
        [f"frames/{name}" for name in reversed(NUMBERS)],
        ["frames/frame_10.obj", "frames", "./frames/*.obj", "frames/frame_1.obj"],
        ["{here}/frames", "frames/*.obj"],
    ],
)
def test_files_folders_and_globs_name_each_frame_once_in_natural_order(frames, arguments):
    typed = [argument.replace("{here}", str(frames.parent)) for argument in arguments]
    sequence = open_sequence(typed, ClipSettings(gaps="close"))
    assert sequence.names == tuple(NUMBERS)


def test_natural_order_goes_by_folder_then_number(tmp_path):
    names = ["b/f1.obj", "a10/f2.obj", "a2/f10.obj", "a2/f9.obj", "a2/F-9.obj"]
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    found = expand_arguments([str(tmp_path / "**" / "*.obj")], (".obj",))
    shown = [str(path.relative_to(tmp_path).as_posix()) for path in found]
    expected = ["a2/F-9.obj", "a2/f9.obj", "a2/f10.obj", "a10/f2.obj", "b/f1.obj"]
    assert shown == expected


def test_names_alike_but_for_zeros_have_one_order(tmp_path):
    names = ["f_001.obj", "f_01.obj", "f_1.obj", "f_02.obj", "f_2.obj"]
    for name in names:
        (tmp_path / name).touch()
    for order in (names, names[::-1], names[2:] + names[:2]):
        found = expand_arguments([str(tmp_path / name) for name in order], (".obj",))
        assert [path.name for path in found] == names


def test_hidden_files_folders_and_other_kinds_in_a_folder_are_passed_by(frames):
    for name in (".hidden.obj", "._frame_1.obj", "notes.txt", "thumbs.db"):
        (frames / name).write_text("not a mesh")
    (frames / "more").mkdir()
    assert open_sequence(["frames"], ClipSettings(gaps="close")).names == tuple(NUMBERS)
    assert open_sequence(["frames/*.obj"], ClipSettings(gaps="close")).names == tuple(NUMBERS)


def test_the_suffix_may_be_in_capitals(frames):
    (frames / "frame_2.obj").rename(frames / "frame_2.OBJ")
    assert len(open_sequence(["frames"], ClipSettings(gaps="close"))) == 4


def test_a_file_whose_name_looks_like_a_glob_is_itself(frames):
    (frames / "frame_1.obj").rename(frames / "frame_[1].obj")
    assert open_sequence(["frames/frame_[1].obj"]).names == ("frame_[1].obj",)


@pytest.mark.parametrize("pattern", ["{}c [1]/*.obj", "{}c [1]/**/*.obj", "{}c [[]1]/*.obj"])
@pytest.mark.parametrize("absolute", [False, True])
def test_a_folder_whose_name_looks_like_a_glob_is_itself(frames, pattern, absolute):
    frames.rename(frames.parent / "c [1]")
    typed = pattern.format(f"{frames.parent}/" if absolute else "")
    assert open_sequence([typed], ClipSettings(gaps="close")).names == tuple(NUMBERS)


def test_a_glob_may_name_folders_as_the_shell_would(frames):
    assert open_sequence(["fram*"], ClipSettings(gaps="close")).names == tuple(NUMBERS)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nowhere"], "nowhere: no such file or folder"),
        (["frames", "nowhere.obj"], "nowhere.obj: no such file or folder"),
        (["frames/*.ply"], "frames/*.ply: no file matches"),
        (["empty"], "empty: no frame found"),
        (["frames/notes.txt"], "frames/notes.txt: `.txt`"),
        (["frames", "clip.npz"], ".npz, .obj are mixed"),
        (["clip.npz", "clop.npz"], "clip.npz: 2 files"),
        (["clip.npz::walk"], "clip.npz::walk: a `.npz` file holds one clip"),
        (["walk.bvh"], "walk.bvh: holds the motion of a skeleton"),
        (["walk.3mf"], "walk.3mf: is a package for 3D printing, which is not read; export the"),
        (["walk.DAE"], "walk.DAE: is a scene in a format that is not read; export it as glTF"),
        (["walk.step"], "walk.step: holds curved surfaces, not a mesh; mesh them, and export"),
        (["walk.C3D"], "walk.C3D: holds the motion of a skeleton"),
        (["walk.fbx"], "walk.fbx: is a scene of another program"),
        (["walk.fbx"], "docs/scripts/bake_rig.py -- walk.fbx walk.abc"),
        (["walk.mb"], "as USD, Alembic or OBJ frames"),
        (["frames"], "frame_3.obj: missing between frame_2.obj and frame_10.obj"),
    ],
)
def test_what_cannot_be_a_clip_is_refused_with_the_argument(frames, arguments, says):
    Path("empty").mkdir()
    for name in ("frames/notes.txt", "clip.npz", "clop.npz", *WALKS):
        Path(name).touch()
    with refused(InputError, says):
        open_sequence(arguments)


def test_a_layout_is_for_arrays_alone(frames):
    with pytest.raises(SettingError, match=r"frames: the axes of `\.obj` files .* `layout=vxf`"):
        open_sequence(["frames"], ClipSettings(layout="vxf", gaps="close"))


def test_only_what_is_no_clip_by_itself_is_outlined(frames):
    assert describe_contents(["frames"], ClipSettings(gaps="close")) == []
    with pytest.raises(FileAccessError, match="nowhere: no such file"):
        describe_contents(["nowhere"], ClipSettings())


@pytest.fixture
def walk(tmp_path, monkeypatch, animation, write_obj):
    """The current folder, with `walk`: three frames, a cage, a rest pose and a result."""
    for k, vertices in enumerate(animation.frames[:3], start=1):
        write_obj(tmp_path / f"walk/walk_{k}.obj", vertices, animation.rest.faces)
    write_obj(tmp_path / "walk/rest.obj", animation.rest.vertices, animation.rest.faces)
    write_obj(tmp_path / "walk/cage_80.obj", animation.cage.vertices, animation.cage.faces)
    (tmp_path / "walk/cages.h5").write_text("a result")
    monkeypatch.chdir(tmp_path)
    return tmp_path / "walk"


def test_a_cage_and_a_rest_pose_beside_frames_are_left_out(walk):
    clip = open_sequence(["walk"])
    assert clip.names == ("walk_1.obj", "walk_2.obj", "walk_3.obj")
    (note,) = texts(clip.notes)
    assert note == ("left out, as not numbered as the frames are: cage_80.obj, cages.h5, rest.obj")
    assert {path.name for path in list_input_files(["walk"])} == set(clip.names)


def test_files_that_are_named_are_never_left_out(walk):
    with pytest.raises(InputError, match=r"rest\.obj: 18 vertices, the rest pose has 8"):
        frames_of(open_sequence(["walk/*.obj"]))


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("walk_-1.obj", "negative"),
        ("walk_1.5.obj", "subframe"),
        ("walk_4.obj.gz", "formats .obj, .obj.gz are mixed"),
        ("walk_02.obj", "has the frame number of walk_"),
    ],
)
def test_what_looks_like_a_frame_is_not_left_out(walk, name, says):
    (walk / name).write_bytes((walk / "walk_1.obj").read_bytes())
    with pytest.raises(InputError, match=says):
        open_sequence(["walk"])


def test_one_of_several_series_must_be_chosen(walk):
    for k in (1, 2):
        (walk / f"run_{k}.obj").write_bytes((walk / f"walk_{k}.obj").read_bytes())
    with pytest.raises(SettingError) as caught:
        open_sequence(["walk"])
    assert "walk: holds 2 series of numbered meshes, run_*, walk_*; choose" in str(caught.value)
    assert f"'{Path('walk', 'run_*.obj')}'" in str(caught.value)
    assert open_sequence(["walk/run_*.obj"]).names == ("run_1.obj", "run_2.obj")


def test_a_folder_without_a_series_is_taken_whole(walk):
    for name in ("walk_2.obj", "walk_3.obj", "cage_80.obj", "cages.h5"):
        (walk / name).unlink()
    clip = open_sequence(["walk"])
    assert (clip.names, texts(clip.notes)) == (("rest.obj", "walk_1.obj"), ())


def save_parts(path, order):
    """Two octahedra and one of another place, by their names, as objects of an OBJ."""
    mesh, lines = octahedron(), []
    for k, name in enumerate(order):
        points = mesh.vertices + {"left": 0, "right": 3, "eye": 6, "nose": 9}[name]
        lines += [f"o {name}", *("v {} {} {}".format(*point) for point in points.tolist())]
        lines += ["f {} {} {}".format(*(face + 1 + 6 * k)) for face in mesh.faces]
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize("order", [("left", "right", "eye"), ("eye", "left", "right")])
def test_parts_of_a_rest_pose_are_told_by_their_names(tmp_path, order):
    """Meshes of one connectivity could be swapped without a word."""
    clip = str(save_parts(tmp_path / "frame_1.obj", ("left", "right", "eye")))
    rest = load_mesh(save_parts(tmp_path / "rest.obj", order))
    sequence, loaded = open_clip_and_rest((clip,), ClipSettings(), rest, 0)
    np.testing.assert_array_equal(loaded.mesh.vertices, sequence.first.vertices)
    assert list_part_names(loaded.mesh) == ("left", "right", "eye")
    is_other = order != ("left", "right", "eye")
    assert ("parts taken in the order of the clip" in texts(loaded.notes)) == is_other


def test_parts_in_other_places_that_are_not_all_known_are_refused(tmp_path):
    clip = str(save_parts(tmp_path / "frame_1.obj", ("left", "right", "eye")))
    rest = load_mesh(save_parts(tmp_path / "rest.obj", ("right", "nose", "eye")))
    with refused(ConnectivityError, "part right is number 1 of its parts, and number 2 of the cl"):
        open_clip_and_rest((clip,), ClipSettings(), rest, 0)
    mesh = load_mesh(save_parts(tmp_path / "rest.obj", ("right", "left", "eye"))).mesh
    with refused(ConnectivityError, "number 2 of the rest pose"):
        check_part_order(mesh, open_sequence([clip]).first, "the rest pose")
    rest = load_mesh(save_parts(tmp_path / "rest.obj", ("left", "nose", "eye")))
    _, loaded = open_clip_and_rest((clip,), ClipSettings(), rest, 0)
    assert list_part_names(loaded.mesh) == ("left", "right", "eye")


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
