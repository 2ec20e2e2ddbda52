"""What the user types becomes frames: every file once, in natural order, of one kind."""

from pathlib import Path

import numpy as np
import pytest

from cageik_cli.formats.base.choose_parts import check_part_order
from cageik_cli.formats.find_files import expand_arguments, list_input_files
from cageik_cli.formats.open import describe_contents, load_mesh, open_clip_and_rest, open_sequence
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.geometry.parts import list_part_names
from cageik_cli.util.errors import ConnectivityError, FileAccessError, InputError, SettingError
from tests.clips import frames_of
from tests.refusals import refused
from tests.shapes import octahedron
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
