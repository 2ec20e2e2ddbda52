"""What is taken for a clip under folders, and what it is called."""

import re
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.batch.discover import (
    discover_clips,
    make_result_name,
    name_results,
    walk_folders,
)
from cageik_cli.util.errors import FileAccessError
from cageik_cli.util.text import make_file_name
from tests.shapes import ball, box, octahedron

OUT = Path("out")


def put(*names):
    for name in names:
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_text("")


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def names(*roots, **options):
    found = discover_clips([Path(root) for root in roots], output=OUT, **options)
    return [clip.name for clip in found]


def test_folders_of_frames_and_files_that_hold_clips_in_natural_order():
    put("a/walk10/f_2.obj", "a/walk10/f_10.obj", "a/walk10/f_1.obj")
    put("a/walk2/sub/1.ply.gz", "a/walk2/sub/2.ply.gz", "a/face.pc2", "a/notes.txt", "a/b.MDD")
    found = discover_clips([Path("a")], output=OUT)
    assert [clip.name for clip in found] == ["b.MDD", "face.pc2", "walk2/sub", "walk10"]
    assert [Path(frame).name for frame in found[3].frames] == ["f_1.obj", "f_2.obj", "f_10.obj"]
    assert found[1].frames == (str(Path("a/face.pc2")),)
    assert [clip.folder for clip in found] == [
        Path("a"),
        *map(Path, ("a", "a/walk2/sub", "a/walk10")),
    ]
    assert found[3].path == Path("a/walk10")
    assert found[1].path == Path("a/face.pc2")


def test_files_that_are_not_clips_are_left_out():
    put("a/one/prop.obj", "a/.hidden/1.obj", "a/.hidden/2.obj", "a/walk/1.obj", "a/walk/2.obj")
    put("a/walk/.3.obj", "a/walk/cage.obj", "a/out/1.obj", "a/out/2.obj")
    cages = {Path("a/walk/cage.obj").resolve()}
    (clip,) = discover_clips([Path("a")], output=Path("a/out"), auxiliary_files=cages)
    assert (clip.name, len(clip.frames)) == ("walk", 2)


def test_meshes_without_a_series_are_not_a_clip():
    """A cage and a rest pose beside each other, say; or beside the frames."""
    put("a/rig/cage.obj", "a/rig/rest.obj", "a/walk/cage.obj", "a/walk/f_1.obj", "a/walk/f_2.obj")
    (clip,) = discover_clips([Path("a")], output=OUT)
    assert (clip.name, len(clip.frames)) == ("walk", 2)


def test_every_series_in_a_folder_is_a_clip():
    put("a/take1_08.obj", "a/take1_09.obj", "a/take2_1.obj", "a/take2_2.obj", "a/take1_10.obj")
    put("a/b/1.obj", "a/b/2.obj", "a/b/x1.ply", "a/b/x2.ply", "a/b/x1.obj", "a/b/x2.obj")
    found = {
        clip.name: [Path(frame).name for frame in clip.frames]
        for clip in discover_clips([Path("a")], output=OUT)
    }
    assert found["a/take1"] == ["take1_08.obj", "take1_09.obj", "take1_10.obj"]
    assert sorted(found) == ["a/take1", "a/take2", "b/frames", "b/x.obj", "b/x.ply"]


def test_a_root_that_is_a_clip_has_its_own_name():
    put("a/walk/1.obj", "a/walk/2.obj")
    assert names("a/walk") == ["walk"]


def test_names_begin_with_the_root_if_there_are_several():
    put("a/walk/1.obj", "a/walk/2.obj", "b/walk/1.obj", "b/walk/2.obj")
    assert names("a", "b") == ["a/walk", "b/walk"]


def test_clips_of_one_name_get_a_digest_of_their_path():
    """Below what all folders share, so that a project may be moved."""
    found = {}
    for place in ("x", "elsewhere/y"):
        put(*(f"{place}/{up}a/{k}.obj" for up in ("", "b/", "c/") for k in (1, 2)))
        roots = [Path(place) / up / "a" for up in ("", "b", "c")]
        clips = discover_clips(roots, output=Path("out"))
        assert len({clip.result for clip in clips}) == len({clip.name for clip in clips}) == 3
        found[place] = [(clip.name, clip.result) for clip in clips]
    assert found["x"] == found["elsewhere/y"]
    (plain, result), *others = found["x"]
    assert (plain, result) == ("a/a", "a_a.h5")
    assert all(re.fullmatch(r"a/[0-9a-f]{8}_a", name) for name, _ in others)


def test_files_whose_names_are_one_on_all_disks_are_both_clips():
    put("a/what?.pc2", "a/what_.pc2")
    found = names("a")
    assert found[0] == "what_.pc2"
    assert re.fullmatch(r"[0-9a-f]{8}_what_\.pc2", found[1])


def test_patterns_leave_clips_out():
    put("a/walk/1.obj", "a/walk/2.obj", "a/run/1.obj", "a/run/2.obj", "a/face.pc2")
    assert names("a", exclude=("r*", "*.pc2")) == ["walk"]


def test_a_link_to_a_folder_above_is_followed_once():
    put("a/walk/1.obj", "a/walk/2.obj")
    Path("a/walk/again").symlink_to(Path("a").resolve())
    assert names("a") == ["walk"]
    assert len(list(walk_folders(Path("a"), Path("out")))) == 2


def test_every_clip_of_a_file_is_one():
    with h5py.File("bodies.hdf5", "w") as file:
        file["50002_jump"] = np.zeros((4, 3, 2))
        file["run: fast"] = np.zeros((4, 3, 2))
        file["faces"] = np.zeros((2, 3), int)
    clips = discover_clips([Path()], output=OUT)
    assert [clip.name for clip in clips] == ["bodies.hdf5/50002_jump", "bodies.hdf5/run_ fast"]
    assert clips[1].frames == ("bodies.hdf5::run: fast",)


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("..", "_"),
        ("a/b", "a_b"),
        ("c:\\d", "c__d"),
        ("x\ny", "x y"),
        ("nul.obj", "_nul.obj"),
        ("x\u0085", "x"),
        (" . ", "_"),
        ("é", "é"),
    ],
)
def test_names_of_clips_are_safe_paths(name, plain):
    assert make_file_name(name) == plain


def test_results_and_bindings_are_not_clips():
    for kind in ("cageik.result", "cageik.binding", "other"):
        with h5py.File(f"{kind}.h5", "w") as file:
            file.attrs["format"] = kind
            file["verts"] = np.zeros((2, 4, 3))
            file["tris"] = np.zeros((2, 3), int)
    put("damaged.h5")
    assert names(".") == ["damaged.h5", "other.h5"]


def test_folders_without_clips_are_refused():
    put("a/notes.txt", "a/one.obj")
    with pytest.raises(FileAccessError, match=r"a: no clip found.*\(\.obj"):
        names("a")
    with pytest.raises(FileAccessError, match="nowhere: "):
        names("nowhere")
    with pytest.raises(FileAccessError, match=r"a\*: is a pattern.*without quotes"):
        names("a*")
    with pytest.raises(FileAccessError, match=r"notes\.txt: "):
        names("a/notes.txt")


def test_results_have_names_that_differ_without_case_and_folders():
    put("a/s010/body.abc", "a/s020/body.abc")
    plain = ["s010_body.abc.h5", "s020_body.abc.h5"]
    assert name_results(names("a")) == plain
    put("a/s010_body.abc", "a/S020/Body.abc")
    found = names("a")
    results = dict(zip(found, name_results(found), strict=True))
    assert len({name.casefold() for name in results.values()}) == len(found)
    digests = [name for name in results.values() if name not in (*plain, "S020_Body.abc.h5")]
    assert all(re.fullmatch(r"[0-9a-f]{8}_s0[12]0_body\.abc\.h5", n, re.I) for n in digests)
    assert len(digests) == 2


def test_results_have_the_same_names_whatever_is_left_out():
    put("a/s010/body.abc", "a/s010_body.abc")
    both = {c.name: c.result for c in discover_clips([Path("a")], output=Path("out"))}
    for name, result in both.items():
        (one,) = discover_clips([Path("a")], output=Path("out"), exclude=[name])
        assert one.result == both[one.name] != result


def test_a_long_name_of_a_result_is_cut_and_stays_different():
    one, other = (make_result_name(f"{start}/{'é' * 150}") for start in "ab")
    assert one != other
    assert {len(name.encode()) for name in (one, other)} <= {202, 203}
    assert make_result_name("w" * 200) == "w" * 200 + ".h5"


def test_meshes_whose_vertices_differ_are_no_clip(write_obj):
    """Cages of several sizes beside the frames, say, whose numbers are not those of frames."""
    notes = []
    for size, mesh in ((60, box()), (120, octahedron()), (300, ball(1))):
        write_obj(Path(f"a/walk/cage_{size}.obj"), mesh.vertices, mesh.faces)
        write_obj(Path(f"a/hats/hat_{size}.obj"), mesh.vertices, mesh.faces)
    with pytest.raises(FileAccessError, match=r"differ are no clip: hats/hat_\*, walk/cage_\*"):
        names("a")
    for k in range(3):
        write_obj(Path(f"a/walk/f_{k}.obj"), ball(1).vertices, ball(1).faces)
    Path("a/walk/f_1.obj").write_text("v 0 0")  # a damaged frame is found by the run
    assert names("a", note=notes.append) == ["walk"]
    assert names("a/walk", "a/hats", note=notes.append) == ["walk/walk"]
    for note, series in zip(
        notes, ("hats/hat_*, walk/cage_*", "walk/cage_*, hats/hat_*"), strict=True
    ):
        assert note.endswith(f": {series}")


@pytest.mark.parametrize("pattern", ["run", "takes/run.abc", "takes/r*"])
def test_a_pattern_is_of_the_name_that_is_listed_or_of_the_path(pattern):
    put("a/takes/walk.abc", "a/takes/run.abc")
    assert names("a", exclude=[pattern]) == ["takes/walk.abc"]


@pytest.mark.parametrize("error", [MemoryError(), RecursionError(), OSError(5, "Input/output")])
@pytest.mark.parametrize("name", ["is_animation", "is_binding", "list_members"])
def test_a_file_that_cannot_be_examined_is_a_clip_that_fails(monkeypatch, name, error):
    put("a/odd.h5", "a/walk/1.obj", "a/walk/2.obj")

    def fail(path):
        raise error

    if name == "list_members":
        monkeypatch.setattr("cageik_cli.formats.hdf5.Reader.list_members", fail)
    else:
        monkeypatch.setattr(f"cageik_cli.batch.discover.{name}", fail)
    assert names("a") == ["odd.h5", "walk"]
