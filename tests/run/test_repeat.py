"""Results extracted again: from their own frames alone, with their own settings."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.captured.settings import CaptureSettings
from cageik_cli.fit.settings import FitSettings
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.run.repeat import extract_again
from cageik_cli.store.result import read_result
from cageik_cli.util.errors import CageikError
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.settings import describe_settings, restore_settings


def repeat(name="cages.h5", clip=None, cage="cage.obj"):
    result = read_result(Path(name))
    extract_again(result, Path(cage), Path("again.h5"), ProgressListener(), clip=clip)
    return read_result(Path("again.h5"))


@pytest.mark.parametrize(
    "words",
    [
        ("frames",),
        ("frames", "--alpha", 0.01, "--no-align", "--coordinates", "mean-value"),
        ("frames", "--rest-frame", 2, "--up-axis", "Z", "--metres-per-unit", 0.01, "--fps", 30),
        ("frames", "--fit", "--fit-regularization", 0.5),
        ("frames", "--robust", "--smooth", "auto", "--fill-gaps"),
        ("frames", "--norm", 4, "--no-weights"),
        ("frames", "--rest", "rest.obj"),
        ("frames", "--vertex-weights", "area"),
    ],
    ids=lambda words: " ".join(map(str, words[1:])) or "plain",
)
def test_in_the_same_cage_the_result_has_the_same_bytes(folder, run, words):
    shutil.copy("frames/frame_1.obj", "rest.obj")
    told = run("extract", *words, "--cage", "cage.obj", "-o", "cages.h5")
    assert told.code == 0, told.err
    repeat()
    assert Path("again.h5").read_bytes() == Path("cages.h5").read_bytes()


def test_a_rest_pose_that_is_not_among_the_frames_is_found(folder, run):
    words = ("--frames", "2-3", "--cage", "cage.obj", "-o", "cages.h5")
    assert run("extract", "frames", *words).code == 0
    before, again = read_result(Path("cages.h5")), repeat()
    assert again.frames == before.frames == ("frame_2.obj", "frame_3.obj")
    np.testing.assert_array_equal(again.metrics.rms, before.metrics.rms)


def test_a_clip_in_one_file_is_taken_by_its_numbers(folder, run):
    assert run("extract", "frames", "--cage", "cage.obj", "-o", "first.h5").code == 0
    assert run("deform", "first.h5", "-o", "clip.pc2").code == 0
    words = ("--rest", "frames/frame_1.obj", "--cage", "cage.obj", "-o", "cages.h5")
    assert run("extract", "clip.pc2", *words, "--frames", "2-3").code == 0
    shutil.copy("frames/frame_1.obj", "frame_1.obj")
    again = repeat()
    assert again.frames == read_result(Path("cages.h5")).frames
    assert Path("again.h5").read_bytes() == Path("cages.h5").read_bytes()


def test_another_cage_gives_other_cages_and_errors(extracted):
    text = Path("cage.obj").read_text().splitlines()
    first = next(k for k, line in enumerate(text) if line.startswith("v "))
    numbers = [2 * float(word) for word in text[first].split()[1:]]
    text[first] = f"v {numbers[0]} {numbers[1]} {numbers[2]}"
    Path("other.obj").write_text("\n".join(text) + "\n")
    before, again = read_result(Path("cages.h5")), repeat(cage="other.obj")
    np.testing.assert_array_equal(again.cage.vertices[0], numbers)
    assert again.sources["frames"] == before.sources["frames"]
    assert again.sources["cage"]["name"] == "other.obj"
    assert not np.array_equal(again.metrics.rms, before.metrics.rms)


def test_frames_elsewhere_are_found_if_they_are_named(extracted):
    Path("far/away").mkdir(parents=True)
    Path("frames").rename("far/away/frames")
    with pytest.raises(CageikError, match=r"not found in .*`clip=`"):
        repeat()
    assert repeat(clip="far/away/frames").frames == read_result(Path("cages.h5")).frames
    Path("again.h5").unlink()
    with pytest.raises(CageikError, match=r"^far: "):
        repeat(clip="far")


def remove_all():
    shutil.rmtree("frames")


def remove_one():
    Path("frames/frame_2.obj").unlink()


def move_a_vertex():
    path = Path("frames/frame_2.obj")
    path.write_text(path.read_text().replace("\nv ", "\nv 0", 1))


def exchange():
    Path("frames/frame_2.obj").rename("frames/x")
    Path("frames/frame_3.obj").rename("frames/frame_2.obj")
    Path("frames/x").rename("frames/frame_3.obj")


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (remove_all, "frame_1.obj ... .*: not found in the current folder"),
        (remove_one, "frame_1.obj ... .*: not found in the current folder"),
        (move_a_vertex, "frame_1.obj ... .*: has changed since cages.h5 was extracted"),
        (exchange, "frame_1.obj ... .*: has changed since cages.h5 was extracted"),
    ],
)
def test_frames_that_are_gone_or_changed_are_refused(extracted, spoil, told):
    spoil()
    with pytest.raises(CageikError, match=f"^{told}"):
        repeat()
    assert not Path("again.h5").exists()


def test_a_rest_pose_that_changed_is_refused(folder, run):
    shutil.copy("frames/frame_1.obj", "rest.obj")
    words = ("--cage", "cage.obj", "--rest", "rest.obj", "-o", "cages.h5")
    assert run("extract", "frames", *words).code == 0
    Path("rest.obj").write_text(Path("rest.obj").read_text() + "# changed\n")
    with pytest.raises(CageikError, match=r"^rest\.obj: the rest pose has changed"):
        repeat()
    Path("rest.obj").unlink()
    with pytest.raises(CageikError, match=r"^rest\.obj: the rest pose is not beside the result"):
        repeat()


def test_weights_that_were_fitted_to_other_clips_are_refused(folder, run):
    bind = ("bind", "--cage", "cage.obj", "--rest", "frames/frame_1.obj", "-o", "b.h5")
    shutil.copytree("frames", "others")
    last = sorted(Path("others").iterdir())[-1]
    last.write_text(last.read_text() + "# other\n")
    assert run(*bind, "--fit", "others").code == 0
    assert run("extract", "frames", "--binding", "b.h5", "-o", "cages.h5").code == 0
    with pytest.raises(CageikError, match=r"^cages\.h5: its weights were fitted to other clips"):
        repeat()


def test_nothing_is_replaced(extracted):
    Path("again.h5").write_bytes(b"mine")
    with pytest.raises(CageikError, match=r"^again\.h5: exists already"):
        repeat()
    assert Path("again.h5").read_bytes() == b"mine"


@pytest.mark.parametrize(
    "settings",
    [
        SolveSettings(),
        SolveSettings(alpha=0.5, norm=4.0),
        BindSettings("mean-value", "fine", "project"),
        CaptureSettings(),
        CaptureSettings(robust=True, smooth="auto", fill_gaps=True),
        CaptureSettings(smooth=0.25),
        FitSettings(),
        FitSettings(regularization=0.1, smoothness=2.0, rank=3),
        ClipSettings(exclude=("eye*", "/hat"), missing=True),
    ],
)
def test_settings_that_are_recorded_are_restored(settings):
    described = {"another": 1, **describe_settings(settings)}
    assert restore_settings(type(settings), described) == settings


def test_a_record_that_is_damaged_is_refused():
    with pytest.raises(CageikError, match="alpha"):
        restore_settings(SolveSettings, {"alpha": "much"})
