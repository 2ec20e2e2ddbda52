"""Folders whose meshes are not frames of one clip are not silently their first mesh."""

import shlex
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.batch.discover import discover_clips
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.util.errors import ConnectivityError, FileAccessError, InputError, SettingError
from tests.clips import frames_of
from tests.formats.polygons import MESH_KINDS, encode_polygons
from tests.refusals import refused
from tests.shapes import ball, box, octahedron
from tests.texts import texts


@pytest.fixture
def place(tmp_path, monkeypatch, write_obj):
    """Write meshes below the current folder, by their names."""
    monkeypatch.chdir(tmp_path)

    def write(**meshes):
        for name, mesh in meshes.items():
            path = Path(name.replace("__", "/") + ".obj")
            write_obj(path, mesh.vertices, mesh.faces)

    return write


def refused_folder(*names):
    with pytest.raises(InputError) as caught:
        open_sequence([*names])
    return str(caught.value)


def test_meshes_of_one_character_are_named(place):
    place(hero__body=ball(1), hero__cap=octahedron(), hero__eye_L=box(), hero__eye_R=box())
    said = refused_folder("hero")
    assert said.startswith("hero: holds 4 meshes that are no frames of one clip (body.obj of 18 ")
    assert "name one of them, as in hero/body.obj, or export them as one file of several" in said


def test_a_folder_of_frames_beside_a_cage_and_a_rest_pose_is_suggested(place):
    place(hero__cage=box(), hero__rest=ball(1))
    place(**{f"hero__frames__walk_{k}": ball(1) for k in range(5)}, hero__other__a=box())
    assert refused_folder("hero").endswith("; did you mean hero/frames, 5 meshes?")
    assert len(open_sequence(["hero/frames"])) == 5


@pytest.mark.parametrize("beside", [{}, {"hero__rest": ball(1)}])
def test_a_folder_of_frames_below_is_suggested(place, beside):
    place(**beside, **{f"hero__{name}__{k}": ball(1) for name in "ab" for k in range(3)})
    assert refused_folder("hero").endswith("did you mean hero/a, 3 meshes or hero/b, 3 meshes?")


def test_numbered_parts_are_no_frames(place):
    place(hero__part_1=ball(1), hero__part_2=box(), hero__part_3=octahedron())
    assert "holds 3 meshes that are no frames of one clip" in refused_folder("hero")


def test_frames_without_numbers_and_one_that_is_damaged_are_a_clip(place):
    place(hero__a=ball(1), hero__b=ball(1))
    assert len(open_sequence(["hero"])) == 2
    place(walk__1=ball(1), walk__2=box(), walk__3=ball(1))
    assert len(open_sequence(["walk"])) == 3
    Path("walk/3.obj").write_text("f 1 2")
    assert len(open_sequence(["walk"])) == 3
    place(one__mesh=ball(1), one__empty__mesh=box())
    assert len(open_sequence(["one"])) == 1


@pytest.mark.parametrize("names", [("hero/body.obj", "hero/cap.obj"), ("hero/*.obj",)])
def test_meshes_that_are_named_one_by_one_are_told_the_same(place, names):
    place(hero__body=ball(1), hero__cap=octahedron())
    said = refused_folder(*names)
    assert said.startswith("hero/body.obj: one of 2 meshes that are no frames of one clip (body.")
    assert "name one of them, as in hero/body.obj, or export them as one file of several" in said
    place(**{f"hero__frames__walk_{k}": ball(1) for k in range(5)})
    assert refused_folder(*names).endswith("; did you mean hero/frames, 5 meshes?")


def test_named_frames_are_a_clip_also_if_a_numbered_one_is_damaged(place):
    place(hero__a=ball(1), hero__b=ball(1), hero__frames__1=ball(1))
    assert len(open_sequence(["hero/a.obj", "hero/b.obj"])) == 2
    place(walk__1=ball(1), walk__2=box(), walk__3=ball(1))
    assert len(open_sequence(["walk/1.obj", "walk/2.obj", "walk/3.obj"])) == 3
    assert len(open_sequence(["walk/*.obj"])) == 3


@pytest.mark.parametrize("name", ["walk_####.obj", "walk_%04d.obj", "walk_$F4.obj"])
def test_the_pattern_of_an_output_is_no_input(place, name):
    place(**{f"frames__walk_{k}": box() for k in range(2)})
    with pytest.raises(FileAccessError, match="folder of the frames, frames, ") as caught:
        open_sequence([f"frames/{name}"])
    assert "'frames/walk_*.obj'" in str(caught.value)
    assert len(open_sequence(["frames/walk_*.obj"])) == 2


def test_a_pattern_that_finds_nothing_says_what_there_is(place):
    place(**{f"frames__walk_{k}": box() for k in range(4)})
    with pytest.raises(FileAccessError, match=r"frames holds walk_0\.obj, .*walk_2\.obj and "):
        open_sequence(["frames/*.ply"])
    with pytest.raises(FileAccessError, match="no folder nowhere; this folder holds frames"):
        open_sequence(["nowhere/*.obj"])


def test_named_files_whose_vertices_differ_are_no_clip_with_missing_numbers(place):
    place(cage_60=box(), cage_120=octahedron(), cage_300=ball(1))
    for arguments in (["cage_*.obj"], ["cage_60.obj", "cage_120.obj", "cage_300.obj"]):
        with pytest.raises(SettingError, match="3 meshes that are no frames of one clip"):
            open_sequence(arguments)


def test_frames_beside_cages_of_several_sizes_are_the_clip(place):
    place(cage_60=box(), cage_120=octahedron(), **{f"f_{k}": ball(1) for k in range(3)})
    clip = open_sequence(["."])
    assert len(clip) == 3
    assert "cage_60.obj, cage_120.obj" in " ".join(texts(clip.notes))


@pytest.mark.parametrize("kind", MESH_KINDS)
def test_every_kind_gives_the_frames(tmp_path, animation, kind):
    faces = animation.rest.faces.tolist()
    for k, vertices in enumerate(animation.frames):
        (tmp_path / f"f{k}.{kind}").write_bytes(encode_polygons(kind, vertices, faces))
    sequence = open_sequence([str(tmp_path)])
    np.testing.assert_array_equal(sequence.first.faces, faces)
    tolerance = 1e-6 if "ply" in kind else 0  # in single precision
    np.testing.assert_allclose(frames_of(sequence), animation.frames, rtol=0, atol=tolerance)


def test_a_frame_in_another_dialect_is_the_same_frame(folder, animation):
    path = folder / "frames/frame_2.obj"
    plain = frames_of(open_sequence(["frames"]))
    path.write_bytes(path.read_bytes().replace(b"\n", b" # behind\r\n").replace(b"\nf", b"\n f"))
    np.testing.assert_array_equal(frames_of(open_sequence(["frames"])), plain)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda v, f: (v, f[:, [1, 0, 2]]), "frame_4.obj: triangle 0 joins vertices"),
        (lambda v, f: (v, f[:-1]), "frame_4.obj: 31 triangles, the rest pose has 32"),
        (lambda v, f: (v[[*range(18), 0]], f), "frame_4.obj: 19 vertices, the rest pose has 18"),
        (lambda v, f: (v * [[1, 1, np.inf]], f), "frame_4.obj: vertex 0 is"),
        (lambda v, f: (v, np.where(f == 17, 18, f)), "frame_4.obj: a face names vertex 19"),
    ],
)
def test_another_connectivity_is_refused_with_the_path(folder, animation, write_obj, change, says):
    vertices, faces = change(animation.frames[3] + 1, animation.rest.faces)
    write_obj(folder / "frames/frame_4.obj", vertices, faces)
    with pytest.raises(InputError) as caught:
        frames_of(open_sequence(["frames"]))
    assert str(caught.value).startswith(str(Path("frames", says)))


DART = np.array([[0.0, 0, 0], [2, 0, 0], [0.5, 0.5, 0], [0, 2, 0]])


@pytest.mark.parametrize("kind", ["obj", "off"])
def test_polygons_are_cut_alike_in_all_frames_as_in_the_first(tmp_path, kind):
    """A dart that opens until it is convex, and bends inward elsewhere."""
    frames = [DART.copy() for _ in range(4)]
    frames[1][2], frames[2][2] = (2, 2, 0), (2, 2, 0)
    frames[2][3] = (1.2, 0.4, 0)
    for k, vertices in enumerate(frames):
        data = encode_polygons(kind, vertices, [[1, 2, 3, 0]])
        if k % 2:  # another dialect
            data = data.replace(b"\nf", b"\n# faces\nf")
        (tmp_path / f"f{k}.{kind}").write_bytes(data)
    sequence = open_sequence([str(tmp_path)])
    np.testing.assert_array_equal(frames_of(sequence), frames)
    a, b, c = (DART[corner] for corner in sequence.first.faces.T)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_another_polygon_is_another_connectivity(tmp_path):
    for k, ring in enumerate([[1, 2, 3, 0], [0, 1, 2, 3]]):
        (tmp_path / f"f{k}.obj").write_bytes(encode_polygons("obj", DART, [ring]))
    with refused(ConnectivityError, "joins vertices 0-1-2, in the rest", at=tmp_path / "f1.obj"):
        frames_of(open_sequence([str(tmp_path)]))


def test_a_frame_that_is_cut_off_within_its_vertices_is_no_point_cloud(folder):
    path = folder / "frames/frame_4.obj"
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:5]))
    with pytest.raises(InputError, match=r"vertices, the rest pose has 18; .*cut off, export"):
        frames_of(open_sequence(["frames"]))


def test_a_frame_that_went_away_is_refused(folder):
    sequence = open_sequence(["frames"])
    (folder / "frames/frame_5.obj").unlink()
    with pytest.raises(FileAccessError, match=r"frame_5\.obj: no such file"):
        frames_of(sequence)


def test_the_source_tells_contents_and_order(folder, animation, write_obj):
    def digest():
        sequence = open_sequence(["frames"])
        frames_of(sequence)
        return sequence.describe_source()

    before = digest()
    assert before["name"] == "frame_1.obj ... frame_5.obj"
    assert before["files"] == 5
    assert digest() == before
    write_obj(folder / "frames/frame_2.obj", animation.frames[2], animation.rest.faces)
    write_obj(folder / "frames/frame_3.obj", animation.frames[1], animation.rest.faces)
    assert digest()["sha256"] != before["sha256"]


def test_stamps_that_are_told_are_not_read_again(folder):
    told = open_sequence(["frames"])
    known = open_sequence(["frames"])
    stamps = [known.digest_or_zeros(k) for k in range(5)]
    source = known.describe_source()
    for k in range(1, 5):
        Path("frames", f"frame_{k + 1}.obj").unlink()
    told.set_digests(0, stamps)
    assert told.describe_source() == source
    told.set_digests(2, [bytes(32)])  # a frame that could not be read there: nothing is known of it
    assert told.digest_or_zeros(2) == stamps[2]


WALK = [f"walk_{k:04}" for k in range(1, 6)]


@pytest.mark.parametrize(
    ("beside", "left_out"),
    [
        (["walk_0003 (1)"], "walk_0003 (1).obj"),
        (["walk_0003 - Kopie", "walk_0003_rest"], "walk_0003 - Kopie.obj, walk_0003_rest.obj"),
        (["walk_0002_lod1", "walk_0004_lod1"], "walk_0002_lod1.obj, walk_0004_lod1.obj"),
        (["a", "b", "c", "d", "e"], "a.obj, b.obj, c.obj and 2 more"),
    ],
)
def test_folder_and_batch_take_the_same_frames_and_name_what_they_leave_out(
    place, beside, left_out
):
    place(**{f"all__clip__{stem}": box() for stem in [*WALK, *beside]})
    clip = open_sequence(["all/clip"])
    assert [Path(name).stem for name in clip.names] == WALK
    assert clip.scene.start == 1
    (note,) = texts(clip.notes)
    assert note == f"left out, as not numbered as the frames are: {left_out}"
    notes = []
    (found,) = discover_clips([Path("all")], output=Path("out"), note=notes.append)
    assert [Path(path).stem for path in found.frames] == WALK
    (note,) = notes
    assert note.replace("clip/", "") == f"left out, as not numbered as the frames are: {left_out}"


@pytest.mark.parametrize(
    "stems",
    [
        [*WALK, *(f"{stem}_lod1" for stem in WALK)],
        [*WALK, *(f"{stem} (1)" for stem in WALK)],
        [f"take{take}_{k}" for take in (1, 12) for k in range(9, 12)],
        [f"{name}'s[x]_{k}" for name in "ab" for k in range(9, 12)],
    ],
)
def test_the_globs_that_choose_a_series_work_when_typed(place, stems):
    """As a shell takes them apart; and a batch has a clip of each."""
    place(**{f"all__clip__{stem}": box() for stem in stems})
    with pytest.raises(SettingError) as caught:
        open_sequence(["all/clip"])
    _, _, choices = str(caught.value).partition("choose one by a quoted glob: ")
    chosen = [
        open_sequence(shlex.split(choice.rpartition(" (")[0])).names
        for choice in choices.split(" or ")
    ]
    assert sorted(name for names in chosen for name in names) == sorted(f"{x}.obj" for x in stems)
    assert len({len(names) for names in chosen}) == 1
    clips = discover_clips([Path("all")], output=Path("out"))
    names = {tuple(Path(path).name for path in clip.frames) for clip in clips}
    assert names == set(chosen)


def test_a_dash_that_all_names_have_is_a_separator(place):
    place(**{f"clip__take -{k:03}": box() for k in (1, 2, 10)})
    with pytest.raises(FileAccessError, match=r"missing between take -002\.obj and take -010\.obj"):
        open_sequence(["clip"])
    clip = open_sequence(["clip"], ClipSettings(gaps="keep"))
    assert (len(clip), clip.scene.start) == (10, 1)
    assert "the dash in take -001.obj is read as a separator, not as a sign" in texts(clip.notes)


def test_fractions_are_frames_in_their_order_where_that_is_asked_for(place):
    place(**{f"clip__sim_{k / 20:g}": box() for k in range(1, 8)})
    with pytest.raises(SettingError, match=r"sim_0.05.obj: the names hold fractions, up to that o"):
        open_sequence(["clip"])
    for gaps in ("keep", "close"):
        clip = open_sequence(["clip"], ClipSettings(gaps=gaps))
        assert clip.names == tuple(f"sim_{k / 20:g}.obj" for k in range(1, 8))
        assert clip.scene.start is None
        assert "the names hold fractions" in " ".join(texts(clip.notes))
    place(**{"clip__sim_0.36": box()})
    with pytest.raises(SettingError, match="the names hold fractions"):
        open_sequence(["clip"], ClipSettings(gaps="keep"))


@pytest.mark.parametrize(
    "stems",
    [
        ["f.-10", "f.-2", "f.-1", "f.0", "f.3"],
        ["f.-10", "f.-2", "f.-1"],
        ["f_1", "f_1.05", "f_1.1", "f_2"],
        ["f 0.9", "f 0.95", "f 1.0", "f 1.05", "f 1.1"],
        ["f_0.25", "f_0.5", "f_0.75", "f_1"],
        ["f_0,9", "f_0,95", "f_1,0", "f_1,05", "f_1,1"],
        ["f_0.033", "f_0.067", "f_0.100", "f_0.133"],
        ["w_0001.00", "w_0001.25", "w_0001.50", "w_0001.75", "w_0002.00"],
    ],
)
def test_closed_gaps_take_numbers_with_signs_and_fractions_in_their_order(place, stems):
    place(**{f"clip__{stem}": box() for stem in stems})
    with pytest.raises(SettingError, match=r"close_gaps=True"):
        open_sequence(["clip"])
    clip = open_sequence(["clip"], ClipSettings(gaps="close"))
    assert [name.removesuffix(".obj") for name in clip.names] == stems


@pytest.mark.parametrize(
    ("beside", "says"),
    [
        (["walk_0003 (1)", "a"], "walk_* (5), 2 more"),
        ([f"{stem}_lod1" for stem in WALK], "walk_* (5), walk_*_lod1 (5)"),
        ([], None),
    ],
)
def test_files_that_are_named_are_all_frames_but_a_note_says_what_they_are(place, beside, says):
    place(**{f"clip__{stem}": box() for stem in [*WALK, *beside]})
    clip = open_sequence(["clip/*.obj"])
    assert len(clip) == len(WALK) + len(beside)
    expected = f"the frames are named in several ways, {says}: they are in the order of their nam"
    notes = [note for note in texts(clip.notes) if "named" in note]
    assert [note.startswith(expected) for note in notes] == ([True] if says else [])
    assert (clip.scene.start == 1) == (not beside)


def test_parts_of_seconds_behind_a_point_are_no_subframes(place):
    stems = [f"cap_12-{k}" for k in ("30-59.0", "30-59.5", "31-00.0", "31-00.5")]
    place(**{f"clip__{stem}": box() for stem in stems})
    clip = open_sequence(["clip"])
    assert [name.removesuffix(".obj") for name in clip.names] == stems
    assert (clip.scene.start, clip.scene.frame_step, texts(clip.notes)) == (1, 1, ())


def test_uneven_time_stamps_are_frames_one_after_another(place):
    """A camera that waits; over a full minute."""
    stems = [f"cap_2024-01-05_12-{k}" for k in ("59-10", "59-11", "59-14", "59-59", "00-02")]
    stems[-1] = "cap_2024-01-05_13-00-02"
    place(**{f"clip__{stem}": box() for stem in stems})
    clip = open_sequence(["clip"])
    assert [name.removesuffix(".obj") for name in clip.names] == stems
    assert clip.scene.start is None
    (note,) = [note for note in texts(clip.notes) if "time stamps" in note]
    assert note == (
        "the time stamps are not evenly spaced (2 places, the first at "
        "cap_2024-01-05_12-59-11.obj): each is used as one frame; `allow_gaps=True` keeps them in "
        "time"
    )
    kept = open_sequence(["clip"], ClipSettings(gaps="keep"))
    assert (len(kept), len(kept.missing)) == (53, 48)
    far = [f"cap_2024-01-{day}_00-00-0{k}" for day in ("05", "09") for k in (0, 1)]
    place(**{f"far__{stem}": box() for stem in far})
    assert len(open_sequence(["far"], ClipSettings(gaps="keep"))) == 4
