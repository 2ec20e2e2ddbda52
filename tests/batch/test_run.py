"""A batch from its jobs to the report over all, whatever becomes of them."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from cageik_cli.batch.jobs import ClipJob, ClipState, Outcome, make_failed_outcome
from cageik_cli.batch.run import (
    FAULT_LABEL,
    LOCK_FILE,
    REPORT_FILES,
    WEIGHT_CACHE_FOLDER,
    BatchPlan,
    check_folder_empty,
    describe_batch,
    run_batch,
)
from cageik_cli.report.figures import KeptSummary
from cageik_cli.report.overview import ClipEntry
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.util.errors import InputError, OutputError
from cageik_cli.util.files import open_locked
from cageik_cli.util.messages import say
from tests.listeners import Listener
from tests.report.markup import parse_page


class Scripted:
    """A scheduler that gives these outcomes, or raises them."""

    def __init__(self, *outcomes):
        self.made, self.has_ended = outcomes, False

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.has_ended = True

    def run_jobs(self, jobs):
        for outcome in self.made:
            if isinstance(outcome, BaseException):
                raise outcome
            yield outcome


@pytest.fixture
def done(entry):
    return lambda name: Outcome(replace(entry, name=name), ClipState.DONE)


def failed(name):
    return Outcome(ClipEntry(name, fault=f"{name}: is broken"), ClipState.FAILED)


def batch_of(output, *names, refused=()):
    jobs = tuple(
        ClipJob(name, ExtractSettings(("x",), None, output / "clips" / f"{name}.h5"))
        for name in names
    )
    entries = tuple(ClipEntry(name, fault="no cage") for name in refused)
    return BatchPlan(output, jobs, entries, tuple(sorted([*names, *refused])))


def test_a_clip_of_good_figures_says_why_it_is_only_fair(tmp_path, entry):
    kept = KeptSummary(0.1, 1.0, 20.0, 1, "a", 0.0, 0, "a")
    summary = replace(entry.report.summary, rms_percent=0.1, max_deviation_percent=1.0)
    report = replace(entry.report, summary=summary, kept=kept, quality="fair")
    doubtful = replace(entry, name="a", report=report)
    heard, plan = Listener(), batch_of(tmp_path / "o", "a")
    run_batch(plan, Scripted(Outcome(doubtful, ClipState.DONE)), heard)
    why = "the error of missing vertices is unknown, so fair at best"
    assert heard.notes == [("a", f"fair: 0.1000 % of the size on average ({why})")]


def test_outcomes_are_noted_as_they_end_and_reported_in_order(tmp_path, done):
    heard, scheduler = Listener(), Scripted(done("c"), failed("a"))
    overview = run_batch(batch_of(tmp_path / "o", "a", "c", refused=["b"]), scheduler, heard)
    assert [entry.name for entry in overview.clips] == ["a", "b", "c"]
    assert [entry.fault for entry in overview.clips] == ["a: is broken", "no cage", None]
    (entry,) = (entry for entry in overview.clips if entry.report)
    text = f"poor: {entry.report.summary.rms_percent:.4f} % of the size on average"
    assert heard.notes == [("b", "failed"), ("c", text), ("a", "failed")]
    assert heard.counts == [(1, 2), (2, 2)]
    assert scheduler.has_ended
    held = json.loads((tmp_path / "o" / "report.json").read_text())
    assert [entry["name"] for entry in held["clips"]] == ["a", "b", "c"]
    assert sorted(path.name for path in (tmp_path / "o").iterdir()) == sorted(
        [*REPORT_FILES, "clips"]
    )
    assert overview.exit_code == 4


def test_what_was_left_out_is_in_the_reports(tmp_path, done):
    """A batch that is quiet says it nowhere else."""
    note = "left out: hats/hat_*"
    plan = replace(batch_of(tmp_path / "o", "a"), notes=(note,))
    run_batch(plan, Scripted(done("a")), Listener())
    read = {name: (tmp_path / "o" / name).read_text() for name in REPORT_FILES}
    assert json.loads(read["report.json"])["notes"] == [note]
    assert f"Note: {note}" in parse_page(read["index.html"]).text
    assert "### Notes\n\n- left out\\: hats/hat" in read["report.md"]
    run_batch(batch_of(tmp_path / "p", "a"), Scripted(done("a")), Listener())
    assert json.loads((tmp_path / "p" / "report.json").read_text())["notes"] == []
    assert "Note: " not in parse_page((tmp_path / "p" / "index.html").read_text()).text


def test_faults_are_in_the_words_of_who_reads_the_report(tmp_path):
    class Failing(Scripted):
        def run_jobs(self, jobs):
            return iter([make_failed_outcome(job, say("try fewer `jobs=`")) for job in jobs])

    batch = batch_of(tmp_path / "o", "a")
    overview = run_batch(batch, Failing(), Listener(), lambda hint: f"--{hint.name}")
    assert [entry.fault for entry in overview.clips] == ["try fewer --jobs"]
    assert "try fewer" in (tmp_path / "o" / "report.md").read_text()


def test_the_order_in_which_clips_end_does_not_change_the_reports(tmp_path, done):
    outcomes = [done("a"), failed("b"), done("c")]
    for name, order in (("one", outcomes), ("two", outcomes[::-1])):
        run_batch(batch_of(tmp_path / name, "a", "b", "c"), Scripted(*order), Listener())
    for view in REPORT_FILES:
        assert (tmp_path / "one" / view).read_bytes() == (tmp_path / "two" / view).read_bytes()


def test_an_interruption_says_how_many_clips_are_done_and_unlocks_the_folder(tmp_path, done):
    scheduler = Scripted(done("a"), KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt) as caught:
        run_batch(batch_of(tmp_path / "o", "a", "b"), scheduler, Listener())
    assert caught.value.__notes__ == ["1 of 2 clips are done; continue with `resume=True`"]
    assert scheduler.has_ended
    assert not (tmp_path / "o" / LOCK_FILE).exists()
    run_batch(batch_of(tmp_path / "o", "a", "b"), Scripted(done("a"), done("b")), Listener())


def test_two_batches_cannot_use_one_folder(tmp_path, done):
    lock = open_locked(tmp_path / LOCK_FILE)
    with pytest.raises(OutputError, match="another batch"):
        run_batch(batch_of(tmp_path, "a"), Scripted(done("a")), Listener())
    lock.close()
    assert run_batch(batch_of(tmp_path, "a"), Scripted(done("a")), Listener()).exit_code == 0


@pytest.mark.parametrize("is_used", [True, False])
def test_the_cache_of_the_batch_is_deleted(tmp_path, done, is_used):
    (tmp_path / WEIGHT_CACHE_FOLDER).mkdir()
    (tmp_path / WEIGHT_CACHE_FOLDER / "x.weights").write_text("")
    batch = batch_of(tmp_path, "a")
    cache = tmp_path / (WEIGHT_CACHE_FOLDER if is_used else "mine")
    job = replace(batch.jobs[0], settings=replace(batch.jobs[0].settings, cache=cache))
    run_batch(replace(batch, jobs=(job,)), Scripted(done("a")), Listener())
    assert (tmp_path / WEIGHT_CACHE_FOLDER).exists() is not is_used


def test_folders_that_cannot_be_made_are_refused(tmp_path, done):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"file: cannot be created \("):
        run_batch(batch_of(tmp_path / "file", "a"), Scripted(done("a")), Listener())


def test_folders_with_files_are_refused(tmp_path):
    check_folder_empty(tmp_path / "new")
    check_folder_empty(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="resume"):
        check_folder_empty(tmp_path)
    with pytest.raises(OutputError, match="file: is a file"):
        check_folder_empty(tmp_path / "file")
    assert Path(tmp_path / "file").exists()


@pytest.fixture
def settings(folder):
    return ExtractSettings(
        (str(folder / "frames"),), folder / "cage.obj", folder / "a.h5", memory=1, resume=True
    )


def describe(settings, rejected=()):
    batch = BatchPlan(
        settings.output.parent,
        (ClipJob("a", settings),),
        tuple(ClipEntry(name, fault="no cage") for name in rejected),
        tuple(sorted(["a", *rejected])),
    )
    return describe_batch(batch)


def state(settings):
    return dict(describe(settings)["a"])["result"].split(".h5, ")[1]


@pytest.mark.usefixtures("single_frame_blocks")
def test_the_state_of_a_result_is_listed(settings, folder):
    assert state(settings) == "would be new"
    with pytest.raises(KeyboardInterrupt):
        extract(settings, Listener(stop_at=(2, 5)))
    before = sorted(folder.rglob("*"))
    assert state(settings) == "would continue from its checkpoint"
    assert state(replace(settings, resume=False, overwrite=True)) == "would be new"
    assert sorted(folder.rglob("*")) == before
    extract(settings)
    assert state(settings) == "up to date, nothing to do"
    assert state(replace(settings, resume=False, overwrite=True)) == "would be replaced"
    assert state(replace(settings, overwrite=True, rest_frame=1)) == "would be replaced"


def test_clips_that_would_fail_say_why(settings, folder):
    missing = replace(settings, cage=folder / "none.obj")
    described = describe(missing, ["b"])
    assert list(described) == ["a", "b"]
    ((label, why),) = described["a"]
    assert label == FAULT_LABEL
    assert "none.obj" in str(why)
    assert described["b"] == [(FAULT_LABEL, "no cage")]
    assert FAULT_LABEL not in dict(describe(settings)["a"])
