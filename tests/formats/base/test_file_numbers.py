"""Frame numbers in the names of files: start, step, gaps, and names without such numbers."""

import re
from pathlib import Path

import pytest

from cageik_cli.formats.base import file_numbers
from cageik_cli.formats.base.file_numbers import FileSeries, FrameNames
from cageik_cli.formats.base.files import file_stem, file_suffix
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import ClipSettings, SceneHints
from cageik_cli.util.errors import FileAccessError, InputError, MissingFrameError, SettingError
from tests.clips import frames_of
from tests.texts import texts


def number(names, gaps="refuse"):
    return FileSeries(tuple(Path("clip") / f"{name}.obj" for name in names.split()), gaps)


def name_all(series):
    return " ".join(path.stem for path in series.paths)


@pytest.mark.parametrize("gaps", ["refuse", "keep", "close"])
@pytest.mark.parametrize(
    ("names", "start", "step"),
    [
        ("walk.1001 walk.1002 walk.1003", 1001, 1),
        ("f0 f1", 0, 1),
        ("f10 f20 f30", 10, 10),
        ("f7 f12", 7, 5),
        ("f1 f02 f003", 1, 1),
        ("walk_v2_0099_low walk_v2_0100_low", 99, 1),
        ("walk_0001_v2 walk_0002_v2", 1, 1),
        ("walk.1001.0 walk.1002.0 walk.1003.0", 1001, 1),
        ("walk.2.0001 walk.2.0002", 1, 1),
        ("walk.1001", 1001, 1),
        ("5", 5, 1),
    ],
)
def test_the_number_that_changes_is_that_of_the_frame(names, start, step, gaps):
    series = number(names, gaps)
    assert series.scene == SceneHints(start=start, frame_step=step)
    assert (name_all(series), series.missing, texts(series.notes)) == (names, {}, ())


@pytest.mark.parametrize("gaps", ["refuse", "keep", "close"])
@pytest.mark.parametrize(
    "names",
    [
        "walk",
        "walk run jump9",
        "a1 a2 b7 b8",
        "a/f1 a/f2 b/f9",
        "f1_low f2_low f3_high",
        "take1_0001 take1_0002 take2_0001",
        "scan_20240131 scan_20240132",
    ],
)
def test_other_names_have_no_frame_numbers(names, gaps):
    series = number(names, gaps)
    assert (series.scene, series.missing, texts(series.notes)) == (SceneHints(), {}, ())


@pytest.mark.parametrize(
    ("names", "missing"),
    [
        ("f1 f2 f4", "f3"),
        ("f8 f9 f10 f12", "f11"),
        ("f_001 f_002 f_004 f_005", "f_003"),
        ("f10 f20 f40 f50", "f30"),
        ("walk2_f1.low walk2_f2.low walk2_f4.low", "walk2_f3.low"),
        ("f_0001_v2 f_0002_v2 f_0004_v2", "f_0003_v2"),
        ("1 2 3 7", "4"),
    ],
)
def test_a_gap_names_the_first_file_that_is_missing(names, missing):
    with pytest.raises(FileAccessError) as caught:
        number(names)
    assert str(caught.value).startswith(f"{Path('clip') / missing}.obj: missing between")
    for option in ("`allow_gaps=True`", "`close_gaps=True`"):
        assert option in str(caught.value)


def test_a_number_between_the_others_is_told():
    with pytest.raises(
        FileAccessError, match=r"f6\.obj: 1 after f5\.obj, .* in steps of 2 \(1 such"
    ):
        number("f1 f3 f5 f6")


@pytest.mark.parametrize(
    ("names", "step", "series", "missing"),
    [
        ("f1 f2 f4", 1, "f1 f2 f3 f4", [2]),
        ("f.1001 f.1003 f.1007 f.1009", 2, "f.1001 f.1003 f.1005 f.1007 f.1009", [2]),
        ("f8 f9 f12", 1, "f8 f9 f10 f11 f12", [2, 3]),
        ("f_098 f_099 f_101", 1, "f_098 f_099 f_100 f_101", [2]),
        ("f1 f3 f5 f6", 1, "f1 f2 f3 f4 f5 f6", [1, 3]),
    ],
)
def test_kept_gaps_are_frames_without_files(names, step, series, missing):
    found = number(names, "keep")
    assert name_all(found) == series
    assert list(found.missing) == missing
    assert found.scene.frame_step == step
    assert found.scene.start == float(names.split()[0].strip("f._"))
    assert texts(found.notes) == ()


def test_a_missing_frame_names_those_around_it():
    assert number("f1 f2 f5", "keep").missing == {
        2: "missing between f2.obj and f5.obj",
        3: "missing between f2.obj and f5.obj",
    }


def test_closed_gaps_are_noted():
    found = number("f.1001 f.1003 f.1007 f.1009", "close")
    assert name_all(found) == "f.1001 f.1003 f.1007 f.1009"
    assert found.scene == SceneHints(start=1001, frame_step=2)
    assert found.missing == {}
    (note,) = texts(found.notes)
    assert "closed at f.1007.obj; frames are numbered from 1001 in steps of 2" in note


@pytest.mark.parametrize("gaps", ["refuse", "keep"])
@pytest.mark.parametrize(
    ("names", "kind", "says"),
    [
        ("f1 f01 f2", FileAccessError, r"f01\.obj: has the frame number of f1\.obj, 1; remove"),
        ("walk.-1 walk.0", SettingError, r"walk\.-1\.obj: has a negative frame number"),
        ("-2 -1", SettingError, r"-2\.obj: has a negative"),
        ("walk_-05_low", SettingError, "has a negative"),
        ("f.1 f.1.5 f.2", SettingError, r"f\.1\.5\.obj: is a subframe of f\.1,"),
        ("f.1.0 f.1.5 f.2.0", SettingError, r"f\.1\.0\.obj: is a subframe of f\.1,"),
    ],
)
def test_numbers_that_are_no_places_in_time_are_refused(names, kind, says, gaps):
    with pytest.raises(kind, match=says):
        number(names, gaps)
    assert name_all(number(names, "close")) == names


@pytest.mark.parametrize("names", ["walk-1 walk-2", "F-9 F-10", "a-1.low a-2.low"])
def test_a_dash_behind_a_letter_is_no_sign(names):
    assert number(names).scene.start == int(names.split()[0].split("-")[1].split(".")[0])


def test_many_missing_frames_are_refused(monkeypatch):
    monkeypatch.setattr(file_numbers, "MAX_MISSING_FRAMES", 3)
    assert len(number("f1 f2 f6", "keep").paths) == 6
    with pytest.raises(
        FileAccessError, match=r"f1\.obj: 4 frames are missing .* `close_gaps=True`"
    ):
        number("f1 f2 f7", "keep")
    with pytest.raises(FileAccessError, match="numbers up to 16777216"):
        number("f20240101 f20240102 f20240104", "keep")
    assert number("f20240101 f20240102 f20240104", "close").scene == SceneHints()


@pytest.fixture
def gappy(folder):
    """Frames 1001, 1003, 1007, 1009 and 1013 in `frames`."""
    for k, new in enumerate((1001, 1003, 1007, 1009, 1013), start=1):
        (folder / f"frames/frame_{k}.obj").rename(folder / f"frames/f.{new}.obj")
    return folder


def open_gappy(gaps, selection=slice(None)):
    return open_sequence(["frames"], ClipSettings(selection, gaps=gaps))


def test_a_clip_knows_its_numbers_and_its_gaps(gappy, animation):
    clip = open_gappy("keep")
    assert clip.names == tuple(f"f.{k}.obj" for k in range(1001, 1014, 2))
    assert clip.scene == SceneHints(start=1001, frame_step=2)
    assert clip.missing == {2, 5}
    for k, frame in ((0, 0), (1, 1), (3, 2), (4, 3), (6, 4)):
        assert (clip.read_frame(k) == animation.frames[frame]).all()
    with pytest.raises(MissingFrameError, match=r"f\.1005\.obj: missing between f\.1003\.obj and"):
        clip.read_frame(2)
    assert clip.digest_or_zeros(2) == bytes(32)
    assert clip.describe_source()["files"] == 5


@pytest.mark.parametrize(
    ("selection", "start", "step", "names", "missing"),
    [
        (slice(1, 5), 1003, 2, "f.1003 f.1005 f.1007 f.1009", {1}),
        (slice(2, 6), 1007, 2, "f.1007 f.1009", set()),
        (slice(None, None, 2), 1001, 4, "f.1001 f.1005 f.1009 f.1013", {1}),
        (slice(1, None, 3), 1003, 6, "f.1003 f.1009", set()),
    ],
)
def test_chosen_frames_keep_their_numbers(gappy, selection, start, step, names, missing):
    clip = open_gappy("keep", selection)
    assert clip.scene == SceneHints(start=start, frame_step=step)
    assert clip.names == tuple(f"{name}.obj" for name in names.split())
    assert clip.missing == missing


def test_frames_that_are_all_missing_are_refused(gappy):
    with pytest.raises(FileAccessError, match=r"f\.1005\.obj: missing between .* `selection=`"):
        open_gappy("keep", slice(2, 3))


def test_a_closed_clip_has_all_its_files(gappy, animation):
    clip = open_gappy("close")
    assert (frames_of(clip) == animation.frames).all()
    assert (clip.missing, clip.scene) == (frozenset(), SceneHints(start=1001, frame_step=2))
    assert "closed at" in texts(clip.notes)[0]
    with pytest.raises(InputError, match=r"f\.1005\.obj: missing"):
        open_gappy("refuse")


@pytest.mark.parametrize(
    ("name", "stem", "kind"),
    [
        ("f.obj", "f", ".obj"),
        ("F.OBJ.GZ", "F", ".obj.gz"),
        ("f.2.low.ply.gz", "f.2.low", ".ply.gz"),
        ("f.gz", "f", ".gz"),
        ("f", "f", ""),
        (".gz", ".gz", ""),
    ],
)
def test_the_kind_of_a_packed_file_has_two_suffixes(name, stem, kind):
    assert file_suffix(Path("folder.obj") / name) == kind
    assert file_stem(Path("folder.obj") / name) == stem


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("cage_####.obj", ("cage_0007.obj", "cage_12345.obj")),
        ("cage.#.ply", ("cage.7.ply", "cage.12345.ply")),
        ("cage_%04d.ply", ("cage_0007.ply", "cage_12345.ply")),
        ("cage_%4d.ply", ("cage_0007.ply", "cage_12345.ply")),
        ("cage_%d.ply", ("cage_7.ply", "cage_12345.ply")),
        ("cage.$F4.obj", ("cage.0007.obj", "cage.12345.obj")),
        ("cage.$F.obj", ("cage.7.obj", "cage.12345.obj")),
        ("##x", ("07x", "12345x")),
        ("cage#.obj", ("cage7.obj", "cage12345.obj")),
        ("shot#3_####.obj", ("shot#3_0007.obj", "shot#3_12345.obj")),
        ("a#_#.obj", ("a#_7.obj", "a#_12345.obj")),
        ("a#b.%d.c.obj", ("a#b.7.c.obj", "a#b.12345.c.obj")),
    ],
)
def test_patterns(pattern, names):
    found = FrameNames.parse(pattern)
    assert (found.file_name(7), found.file_name(12345)) == names
    assert all(map(found.matches, names))
    assert FrameNames.parse(found.pattern) == found


@pytest.mark.parametrize(
    "name",
    [
        "cage.obj",
        "cage_%x.obj",
        "cage_0001.obj",
        "$cage.obj",
        "",
        "shot#3",
        "#3.obj",
        "C#",
        "a#b.obj",
        "a#.b.obj",
        "# .c#",
    ],
)
def test_what_has_no_number_is_no_pattern(name):
    assert FrameNames.parse(name) is None


@pytest.mark.parametrize("name", ["a_##_##.obj", "a_%d_$F.obj", "$F_%04d"])
def test_a_number_stands_there_once(name):
    with pytest.raises(SettingError, match=rf"{re.escape(name)} has 2 "):
        FrameNames.parse(name)


@pytest.mark.parametrize(
    "name",
    ["c_01.obj", "c_001.ply", "d_001.obj", "c_001.obj.txt", "xc_001.obj", "c_0x1.obj", "c+001.obj"],
)
def test_other_names_are_not_ours(name):
    """Names around the number are taken letter by letter."""
    assert not FrameNames("c_", 3, ".obj").matches(name)
    assert not FrameNames("c.", 3, ".obj").matches(name)
