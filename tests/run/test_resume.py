"""Runs that end early: what they leave, how they go on, and that nobody can tell afterwards."""

import csv
import io
import json
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.formats.settings import SceneHints
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.report.record import build_report
from cageik_cli.report.views.data import format_csv, format_json
from cageik_cli.report.views.text import format_text
from cageik_cli.run import executor
from cageik_cli.run.edit import edit
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import EditSettings, ExtractSettings
from cageik_cli.store.checkpoint import checkpoint_progress
from cageik_cli.util.errors import CheckpointError, FileAccessError, InputError
from tests.listeners import Listener

LOG = Path("cages.h5.partial")


@pytest.fixture
def plain(folder, single_frame_blocks):
    """Settings for the little animation, a frame a block."""
    return ExtractSettings(
        frames=("frames",),
        cage=Path("cage.obj"),
        output=Path("cages.h5"),
        scene=SceneHints(metres_per_unit=1.0),  # else there is a note on it
    )


@pytest.fixture
def whole(plain):
    """The bytes of a run that nobody interrupts."""
    return extract(replace(plain, output=Path("whole.h5"))).path.read_bytes()


def interrupted(settings, after):
    with pytest.raises(KeyboardInterrupt) as caught:
        extract(settings, Listener(stop_at=(after, 5)))
    return caught.value


@pytest.mark.parametrize("after", [1, 2, 4, 5])
def test_a_resumed_run_gives_the_same_bytes(plain, whole, after):
    error = interrupted(plain, after)
    (kept,) = error.__notes__
    assert kept.startswith(f"{after} of 5 frames are kept in cages.h5.partial; ")
    assert checkpoint_progress(LOG) == (after, 5)
    watch = Listener()
    result = extract(replace(plain, resume=True), watch)
    assert result.path.read_bytes() == whole
    assert watch.notes == [("resumed", f"after {after} of 5 frames")]
    assert not LOG.exists()


def test_a_run_may_be_interrupted_several_times(plain, whole):
    for after in (1, 2, 3, 4):
        interrupted(replace(plain, resume=True), after)
    assert extract(replace(plain, resume=True)).path.read_bytes() == whole


def test_memory_and_jobs_may_change_before_a_run_is_resumed(plain, whole):
    interrupted(plain, 2)
    settings = replace(plain, resume=True, memory=1, jobs=3)
    assert extract(settings).path.read_bytes() == whole


def test_resume_without_a_checkpoint_starts_a_run(plain, whole):
    watch = Listener()
    assert extract(replace(plain, resume=True), watch).path.read_bytes() == whole
    assert watch.notes == []


def test_a_checkpoint_is_replaced_only_on_request(plain, whole):
    interrupted(plain, 2)
    with pytest.raises(CheckpointError, match=r"cages\.h5\.partial: .*2 of 5 frames"):
        extract(plain)
    assert checkpoint_progress(LOG) == (2, 5)
    assert extract(replace(plain, overwrite=True)).path.read_bytes() == whole


def test_a_run_with_other_settings_is_refused(plain):
    interrupted(plain, 2)
    other = replace(plain, resume=True, solve=SolveSettings(alpha=0.5))
    with pytest.raises(CheckpointError, match=r"cages\.h5\.partial: .*with `alpha=0\.001`; "):
        extract(other)
    assert checkpoint_progress(LOG) == (2, 5)


def test_a_run_at_another_rate_is_refused(plain):
    """Some files are sampled at the rate, so frames of the same number differ."""
    interrupted(plain, 2)
    with pytest.raises(CheckpointError, match=r"cages\.h5\.partial"):
        extract(replace(plain, resume=True, scene=SceneHints(fps=30, metres_per_unit=1.0)))
    assert checkpoint_progress(LOG) == (2, 5)


def test_frames_that_changed_are_solved_again(plain, animation, write_obj):
    interrupted(plain, 4)
    write_obj(Path("frames/frame_3.obj"), animation.frames[2] + 0.25, animation.rest.faces)
    watch = Listener()
    resumed = extract(replace(plain, resume=True), watch).path.read_bytes()
    text = "after 2 of 5 frames (frame_3.obj has changed)"
    assert watch.notes == [("resumed", text)]
    assert resumed == extract(replace(plain, output=Path("whole.h5"))).path.read_bytes()


def test_a_run_resumes_after_a_bad_frame_is_repaired(plain, whole):
    frame = Path("frames/frame_4.obj")
    text = frame.read_text()
    frame.write_text("no mesh")
    with pytest.raises(InputError, match=r"frame_4\.obj") as caught:
        extract(plain)
    assert "3 of 5 frames are kept" in caught.value.__notes__[-1]
    frame.write_text(text)
    assert extract(replace(plain, resume=True)).path.read_bytes() == whole


def test_an_existing_result_is_kept(plain, whole):
    extract(plain)
    watch = Listener()
    assert extract(replace(plain, resume=True), watch).path.read_bytes() == whole
    assert watch.notes == [("unchanged", "up to date, nothing to do")]


def test_an_existing_result_is_found_before_weights_are_computed(plain, whole, monkeypatch):
    extract(plain)

    def bind(*given):
        raise AssertionError("bound")

    monkeypatch.setattr("cageik_cli.run.extraction.bind_cached", bind)
    assert extract(replace(plain, resume=True)).path.read_bytes() == whole
    with pytest.raises(AssertionError, match="bound"):
        extract(replace(plain, resume=True, overwrite=True, keep_weights=False))


def test_resume_with_overwrite_replaces_other_results_and_checkpoints(plain, whole):
    """--resume with --overwrite takes what is this run's, and replaces what is not."""
    other = replace(plain, solve=SolveSettings(alpha=0.5))
    both = replace(plain, resume=True, overwrite=True)
    interrupted(other, 2)
    assert extract(both).path.read_bytes() == whole
    extract(replace(other, overwrite=True))
    assert extract(both).path.read_bytes() == whole
    watch = Listener()
    extract(both, watch)
    assert watch.notes == [("unchanged", "up to date, nothing to do")]
    Path("cages.h5").unlink()
    interrupted(plain, 3)
    extract(both, watch)
    assert watch.notes[1:] == [("resumed", "after 3 of 5 frames")]


def test_a_key_frame_that_changes_during_the_run_is_refused(plain, animation, write_obj):
    class Changing(Listener):
        def update(self, done, total):
            for k in range(1, 6) if total == done == 5 else ():
                path, vertices = Path(f"frames/frame_{k}.obj"), k * animation.frames[0]
                write_obj(path, vertices, animation.rest.faces)

    with pytest.raises(FileAccessError, match=r"frame_\d\.obj: changed"):
        extract(plain, Changing())
    assert not Path("cages.h5").exists()


def test_a_run_killed_before_its_checkpoint_is_deleted_is_complete(plain, whole):
    interrupted(plain, 5)
    Path("cages.h5").write_bytes(whole)
    Path("cages.h5.whole.partial").write_text("half")
    assert extract(replace(plain, resume=True)).path.read_bytes() == whole
    assert not LOG.exists()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"solve": SolveSettings(alpha=0.5)}, "other settings"),
        ({"keep_weights": False}, "other settings"),
        ({"frames": ("frames/frame_1.obj", "frames/frame_2.obj")}, "other frames"),
        ({"cage": Path("other.obj")}, "other files"),
    ],
)
def test_resume_does_not_replace_another_result(plain, whole, change, says):
    extract(plain)
    Path("other.obj").write_text(Path("cage.obj").read_text() + "# other\n")
    with pytest.raises(CheckpointError, match=rf"cages\.h5: .*{says}"):
        extract(replace(plain, resume=True, **change))
    assert Path("cages.h5").read_bytes() == whole


def test_resume_replaces_an_edit_only_on_request(plain, whole):
    result = extract(plain)
    moves = [{"vertex": 0, "offset": [0.1, 0.0, 0.0]}]
    Path("moves.json").write_text(json.dumps({"edits": [{"name": "a", "moves": moves}]}))
    edit(EditSettings(result.path, None, Path("edit.h5"), cage_edits=Path("moves.json")))
    Path("edit.h5").replace("cages.h5")
    with pytest.raises(CheckpointError, match=r"cages\.h5: is an edit by cageik pose"):
        extract(replace(plain, resume=True))
    assert extract(replace(plain, resume=True, overwrite=True)).path.read_bytes() == whole


def test_a_result_of_another_version_is_another_result(plain, whole, monkeypatch):
    extract(plain)
    monkeypatch.setattr("cageik_cli.run.resume.__version__", "9.9")
    with pytest.raises(CheckpointError, match=r"cages\.h5: .*another version"):
        extract(replace(plain, resume=True))
    assert Path("cages.h5").read_bytes() == whole


@pytest.fixture
def gapped(plain, whole, animation, write_obj):
    """Frames of which the second and fourth are no good, once a sound run was made of them."""
    Path("frames/frame_2.obj").write_text("no mesh")
    write_obj(Path("frames/frame_4.obj"), animation.frames[3] * np.nan, animation.rest.faces)
    return plain


SKIPPED = {"frames/frame_2.obj": "0 vertices and 0 faces", "frames/frame_4.obj": "vertex 0 is"}


@pytest.mark.parametrize("size", [1, 16])
def test_a_skipped_frame_leaves_a_gap(gapped, monkeypatch, size):
    monkeypatch.setattr(executor, "MAX_BLOCK_FRAMES", size)
    result = extract(replace(gapped, on_bad_frame="skip"))
    assert result.frames == tuple(f"frame_{k}.obj" for k in range(1, 6))
    assert list(result.skipped) == [1, 3]
    for text, (place, why) in zip(result.skipped.values(), SKIPPED.items(), strict=True):
        assert str(text).startswith(place)
        assert why in str(text)
    with h5py.File("cages.h5") as file, h5py.File("whole.h5") as other:
        found, expected = file["verts"][:], other["verts"][:]
        rms, known = file["metrics/rms"][:], other["metrics/rms"][:]
    assert np.isnan(found[[1, 3]]).all()
    assert np.isnan(rms[[1, 3]]).all()
    good = [0, 2, 4]
    np.testing.assert_allclose(found[good], expected[good], rtol=0, atol=1e-13)
    np.testing.assert_allclose(rms[good], known[good], rtol=0, atol=1e-13)


def test_other_frames_do_not_depend_on_the_gaps(gapped, monkeypatch):
    """To the last bit, though they share a block with them."""
    monkeypatch.setattr(executor, "MAX_BLOCK_FRAMES", 16)
    extract(replace(gapped, on_bad_frame="skip"))
    for k in (2, 4):
        Path(f"frames/frame_{k}.obj").write_text(Path("frames/frame_1.obj").read_text())
    extract(replace(gapped, output=Path("full.h5")))
    with h5py.File("cages.h5") as file, h5py.File("full.h5") as other:
        assert file["verts"][::2].tobytes() == other["verts"][::2].tobytes()


def test_a_resumed_run_with_gaps_gives_the_same_bytes(gapped):
    expected = extract(replace(gapped, output=Path("gaps.h5"), on_bad_frame="skip"))
    interrupted(replace(gapped, on_bad_frame="skip"), 3)
    result = extract(replace(gapped, on_bad_frame="skip", resume=True))
    assert result.path.read_bytes() == expected.path.read_bytes()


def test_a_gap_is_solved_when_its_file_was_repaired(gapped):
    interrupted(replace(gapped, on_bad_frame="skip"), 4)
    Path("frames/frame_2.obj").write_text(Path("frames/frame_1.obj").read_text())
    result = extract(replace(gapped, on_bad_frame="skip", resume=True))
    assert list(result.skipped) == [3]


def test_a_run_without_skipping_does_not_resume_over_a_gap(gapped):
    interrupted(replace(gapped, on_bad_frame="skip"), 3)
    with pytest.raises(InputError, match=r"frame_2\.obj: 0 vertices") as caught:
        extract(replace(gapped, resume=True))
    assert "3 of 5 frames are kept" in caught.value.__notes__[-1]


def test_a_gap_that_stops_a_run_leaves_the_checkpoint_as_it_is(gapped):
    interrupted(replace(gapped, on_bad_frame="skip"), 5)
    log = LOG.read_bytes()
    with pytest.raises(InputError, match=r"frame_2\.obj: 0 vertices"):
        extract(replace(gapped, resume=True))
    assert LOG.read_bytes() == log


def test_a_frame_that_was_damaged_leaves_the_checkpoint_as_it_is(plain, whole):
    interrupted(plain, 4)
    log, frame = LOG.read_bytes(), Path("frames/frame_3.obj")
    sound = frame.read_bytes()
    frame.write_bytes(sound[:-9])
    with pytest.raises(InputError, match=r"frame_3\.obj: "):
        extract(replace(plain, resume=True))
    assert LOG.read_bytes() == log
    frame.write_bytes(sound)
    assert extract(replace(plain, resume=True)).path.read_bytes() == whole


def test_a_result_with_gaps_is_refused_by_a_run_without_skipping(gapped):
    result = extract(replace(gapped, on_bad_frame="skip"))
    data = result.path.read_bytes()
    with pytest.raises(CheckpointError, match=r"cages\.h5: 2 frames .*frame_2\.obj: 0 vertices"):
        extract(replace(gapped, resume=True))
    assert result.path.read_bytes() == data
    again = extract(replace(gapped, resume=True, on_bad_frame="skip"))
    assert list(again.skipped) == [1, 3]


def test_a_clip_of_gaps_only_is_refused(plain):
    """The first frame, which tells the connectivity, is damaged after it was opened."""

    class Damaging(Listener):
        @contextmanager
        def stage(self, name):
            yield
            if name == "open":
                for path in Path("frames").iterdir():
                    path.write_text("no mesh")

    with pytest.raises(FileAccessError, match=r"frame_1\.obj: 0 ver"):
        extract(replace(plain, on_bad_frame="skip"), Damaging())
    assert not Path("cages.h5").exists()


def test_the_report_names_the_gaps(gapped):
    report = build_report(extract(replace(gapped, on_bad_frame="skip")))
    text = format_text(report)
    row = next(line for line in text.splitlines() if line.startswith("  skipped"))
    assert "2 of 5 frames: frame_2.obj, frame_4.obj; frames/frame_2.obj: 0 vertices" in row
    assert "nan" not in text
    record = json.loads(format_json([report]))
    assert record["summary"]["frames_skipped"] == 2
    gap = record["frames"][1]
    assert "0 vertices" in gap.pop("skipped")
    assert {key for key, value in gap.items() if value is not None} == {
        "index", "number", "name"
    }  # fmt: skip
    assert record["frames"][2]["skipped"] is None
    good = [frame["rms"] ** 2 for frame in record["frames"] if frame["rms"] is not None]
    assert record["summary"]["rms"] == pytest.approx(np.sqrt(np.mean(good)), rel=1e-12)
    row = list(csv.DictReader(io.StringIO(format_csv([report]))))[1]
    assert (row["name"], row["rms"], row["volume"]) == ("frame_2.obj", "", "")
    assert "0 vertices" in row["skipped"]


TYPED = ("extract", "frames/*.obj", "--cage", "cage.obj")


def test_the_command_says_what_is_kept_and_resumes(run, gapped):
    outcome = run(*TYPED)
    assert outcome.code == 1
    assert outcome.err.splitlines()[-1].endswith(
        "1 of 5 frames are kept in cages.h5.partial; continue with --resume, or start over "
        "with --overwrite"
    )
    for name in ("cages.h5", "cages.h5.partial"):
        said = run("report", name)
        assert said.code == 1
        assert "rerun the command with --resume" in said.err
    assert "1 of 5; rerun the command with --resume" in run("info", LOG).out
    outcome = run(*TYPED, "--resume", "--on-bad-frame", "skip", "-v")
    assert outcome.code == 0
    assert "resumed after 1 of 5 frames" in " ".join(outcome.err.split())
    assert "skipped        2 of 5 frames" in outcome.err
    assert "skipped        frame_2.obj, frame_4.obj; cageik report" in run("info", "cages.h5").out


def test_a_gap_is_noted_once_for_several_exports(run, gapped):
    exports = ("--export", "cages.npz", "--export", "cages.mdd")
    outcome = run(*TYPED, "-v", "--on-bad-frame", "skip", *exports)
    assert outcome.code == 0
    assert outcome.err.count("2 of 5 frames skipped (frame_2.obj, frame_4.obj)") == 1


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_grids")
def test_a_run_with_a_built_cage_goes_on_to_the_same_bytes(plain):
    built = replace(plain, cage=None, build=BuildSettings(20))
    whole = extract(replace(built, output=Path("whole.h5"))).path.read_bytes()
    interrupted(built, 2)
    with pytest.raises(CheckpointError, match="`cage_vertices=20`"):
        extract(replace(built, build=BuildSettings(21), resume=True))
    listener = Listener()
    assert extract(replace(built, resume=True), listener).path.read_bytes() == whole
    assert ("resumed", "after 2 of 5 frames") in listener.notes
