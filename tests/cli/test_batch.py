"""`cageik batch`: every clip under a folder, whatever becomes of one of them."""

import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest

import cageik_cli.cli.batch as command
import cageik_cli.report
from cageik_cli.batch import dask_cluster
from cageik_cli.batch.discover import make_result_name
from cageik_cli.batch.run import WEIGHT_CACHE_FOLDER
from cageik_cli.inputs import weights
from cageik_cli.store.checkpoint import CHECKPOINT_MAGIC
from cageik_cli.store.result import read_result
from tests.cli.conftest import Here
from tests.conftest import _use_coarse_panels, run_in_process
from tests.texts import texts

BATCH = ("batch", "anim", "-o", "out", "--no-pages")


@pytest.fixture
def anim(folder, animation, write_obj) -> Path:
    """Clips `walk`, `runs/fast` and `face.npz` of the little animation, with their cage above."""
    return write_anim(animation, write_obj)


def write_anim(animation, write_obj):
    for name in ("walk", "runs/fast"):
        for k, vertices in enumerate(animation.frames, start=1):
            write_obj(Path("anim") / name / f"f_{k}.obj", vertices, animation.rest.faces)
    np.savez("anim/face.npz", verts=animation.frames[:3], faces=animation.rest.faces)
    write_obj(Path("anim/cage.obj"), animation.cage.vertices, animation.cage.faces)
    Path("anim/cageik.toml").write_text('[extract]\ncage = "cage.obj"\n')
    return Path("anim")


@pytest.fixture(scope="module")
def finished(tmp_path_factory, animation, write_obj) -> Path:
    """A folder, read only, with the clips of `anim` and the finished batch of them in `out`."""
    folder = tmp_path_factory.mktemp("batch")
    with pytest.MonkeyPatch.context() as monkeypatch:
        _use_coarse_panels(monkeypatch)
        monkeypatch.setenv("CAGEIK_CACHE", str(folder / "cache"))
        monkeypatch.delenv("GITHUB_STEP_SUMMARY", raising=False)
        monkeypatch.setattr(command, "_choose_scheduler", lambda *options: Here())
        monkeypatch.chdir(folder)
        write_anim(animation, write_obj)
        assert run_in_process(*BATCH).code == 0
    return folder


@pytest.fixture
def done(finished, tmp_path, monkeypatch, coarse_panels, here) -> Path:
    """The current folder, with a finished batch."""
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def report():
    return {
        entry["name"]: entry for entry in json.loads(Path("out/report.json").read_text())["clips"]
    }


@pytest.mark.slow
def test_every_clip_is_extracted_as_if_alone(run, anim, here):
    outcome = run(*BATCH[:-1], "--pages")
    assert (outcome.code, outcome.out) == (0, "")
    assert "3 clips: 3 done, 0 failed, 0 over a limit" in outcome.err
    assert "wrote out/index.html" in outcome.err
    assert list(report()) == ["face.npz", "runs/fast", "walk"]
    assert report()["walk"]["result"] == "clips/walk.h5"
    page = Path("out", report()["walk"]["page"])
    assert "<h1" in page.read_text()
    assert "data-player" not in page.read_text()
    assert run(*BATCH[:-1], "--pages", "--player", "--resume").code == 0
    assert "data-player" in page.read_text()
    run("extract", "anim/walk", "--cage", "anim/cage.obj", "-o", "alone.h5")
    assert Path("out/clips/walk.h5").read_bytes() == Path("alone.h5").read_bytes()
    names = {"index.html", "report.json", "clips.csv", "junit.xml", "report.md", "clips"}
    assert {path.name for path in Path("out").iterdir()} == names


def test_one_that_fails_leaves_the_others_alone(run, anim, here):
    Path("anim/walk/f_3.obj").write_text("no mesh")
    outcome = run(*BATCH)
    assert outcome.code == 4
    assert "2 done, 1 failed" in outcome.err
    assert "f_3.obj: 0 vertices" in report()["walk"]["fault"]
    assert report()["walk"]["result"] is None
    assert outcome.err.splitlines()[-2].startswith("walk: ")  # where a log is looked at
    assert "f_3.obj: 0 vertices" in outcome.err.splitlines()[-2]


def test_all_that_fail_are_a_failure(run, anim, here):
    Path("anim/cage.obj").write_text("no mesh")
    assert run(*BATCH, "-q").code == 1
    assert all(entry["fault"] for entry in report().values())


@pytest.mark.parametrize(
    ("words", "source"), [((), ", of DASK_SCHEDULER_ADDRESS"), (("--scheduler", "a:1"), "")]
)
def test_the_scheduler_that_gets_the_jobs_is_named(run, anim, monkeypatch, words, source):
    monkeypatch.setenv("DASK_SCHEDULER_ADDRESS", "a:1")
    monkeypatch.setattr(dask_cluster, "DaskScheduler", lambda address: Here())
    outcome = run(*BATCH, *words)
    assert f"note: jobs go to the scheduler a:1{source}" in outcome.err.splitlines()


def test_what_keeps_all_from_beginning_is_said_once(run, anim, here):
    outcome = run(*BATCH, "--baseline", "old.json")
    assert outcome.code == 1
    assert len(outcome.err.splitlines()) == 1
    assert "3 clips" in outcome.err
    assert "old.json: " in outcome.err
    assert not Path("out").exists()


@pytest.mark.slow
def test_clips_without_a_cage_get_one_that_is_built_once(
    run, anim, here, coarse_grids, monkeypatch
):
    built = []

    def count(*given):
        built.append(given)
        return build(*given)

    build = weights._build
    monkeypatch.setattr(weights, "_build", count)
    Path("anim/cageik.toml").write_text("[extract]\ncage-vertices = 20\n")
    planned = run(*BATCH, "--dry-run")
    assert planned.out.count("  cage           would be built, of 20 vertices") == 3
    assert run(*BATCH).code == 0
    assert [entry["fault"] for entry in report().values()] == [None] * 3
    walk = read_result(Path("out/clips/walk.h5"))
    assert walk.sources["cage"]["name"] == "built cage"
    assert run(*BATCH, "--resume").err.count("unchanged, good: ") == 3
    assert len(built) == 1  # their rest poses are the same


def test_each_clip_may_have_the_cage_in_its_own_folder(run, anim, here, animation, write_obj):
    Path("anim/cageik.toml").write_text('cage = "{clip}/around.obj"\n')
    for size, place in ((1.0, "walk"), (1.1, "runs/fast")):
        write_obj(
            Path("anim", place, "around.obj"), size * animation.cage.vertices, animation.cage.faces
        )
    outcome = run(*BATCH)
    assert (outcome.code, here) == (4, ["face.npz", "runs/fast", "walk"])
    assert [name for name, entry in report().items() if entry["fault"]] == ["face.npz"]
    assert report()["face.npz"]["fault"].endswith("anim/around.obj: no such file; check the path")
    fast = read_result(Path("out/clips/runs_fast.h5"))
    np.testing.assert_array_equal(fast.cage.vertices, 1.1 * animation.cage.vertices)


def test_a_clip_with_a_cage_has_no_size_of_one_that_is_built(run, anim, here):
    Path("anim/walk/cageik.toml").write_text("cage-vertices = 20\n")
    assert run(*BATCH).code == 4
    faults = {name: entry["fault"] for name, entry in report().items() if entry["fault"]}
    assert list(faults) == ["walk"]
    assert "leave out --cage-vertices or --cage" in faults["walk"]
    outcome = run(*BATCH, "--overwrite", "--cage", "anim/cage.obj", "--cage-vertices", "20")
    assert outcome.code == 2
    assert "none of 3 clips can be started: --cage-vertices is for" in outcome.err


def test_frames_that_no_clip_has_stop_a_batch_at_once(run, anim, here):
    outcome = run(*BATCH, "--frames", "20-5")
    assert (outcome.code, Path("out").exists()) == (2, False)
    assert "none of 3 clips can be started: --frames 20-5: ends before it begins" in outcome.err
    Path("anim/walk/cageik.toml").write_text('frames = "3:3"\n')
    assert run(*BATCH).code == 4
    assert [name for name, entry in report().items() if entry["fault"]] == ["walk"]


def test_the_rest_frame_of_each_clip_may_be_chosen(run, anim, here):
    Path("anim/cageik.toml").write_text('cage = "cage.obj"\nrest-frame = "auto"\n')
    assert run(*BATCH).code == 0
    walk = read_result(Path("out/clips/walk.h5"))
    assert walk.settings["rest_frame"] == 0
    assert [note for note in texts(walk.notes) if "frame 1 is the rest pose" in note]
    assert run(*BATCH, "--resume").err.count("unchanged, poor: ") == 3


def test_going_on_does_what_is_new_changed_or_failed(run, anim, here, animation, write_obj):
    Path("anim/walk/f_3.obj").write_text("no mesh")
    run(*BATCH)
    walk, faces = animation.frames[2], animation.rest.faces
    write_obj(Path("anim/walk/f_3.obj"), walk, faces)
    write_obj(Path("anim/runs/fast/f_2.obj"), walk, faces)
    face = Path("out/clips/face.npz.h5").stat()
    outcome = run(*BATCH, "--resume")
    assert outcome.code == 0
    said = {line.split()[0]: line.split()[1] for line in outcome.err.splitlines()[:3]}
    assert said == {"face.npz": "unchanged,", "runs/fast": "poor:", "walk": "poor:"}
    figure = report()["walk"]["summary"]["rms_percent"]
    assert f"  walk           poor: {figure:.4f} % of the size on average\n" in outcome.err
    assert Path("out/clips/face.npz.h5").stat() == face
    held = {name: Path("out", name).read_bytes() for name in ("report.json", "index.html")}
    assert run("batch", "anim", "-o", "new", "--no-pages").code == 0
    for name, data in held.items():
        assert Path("new", name).read_bytes() == data


def test_timings_of_a_batch_are_in_its_junit(run, anim, here):
    assert run(*BATCH, "--timings", "seconds.json").code == 0
    seconds = json.loads(Path("seconds.json").read_text())
    assert seconds.keys() == {"batch", "write", "total"}
    suites = ElementTree.parse("out/junit.xml").getroot()
    times = [float(suite.get("time")) for suite in suites]
    assert len(times) == 3
    assert min(times) > 0
    assert sum(times) < seconds["batch"] + 3 * 0.0005  # they are rounded
    assert run(*BATCH, "--resume", "--timings", "seconds.json").code == 0
    again = json.loads(Path("seconds.json").read_text())
    assert again.keys() == seconds.keys()
    assert again != seconds
    assert run(*BATCH, "--resume").code == 0
    suites = ElementTree.parse("out/junit.xml").getroot()
    assert {element.get("time") for element in suites.iter() if "time" in element.attrib} == {"0"}


@pytest.mark.parametrize(
    "text", ["", "[1]", "{}", '{"total": "a"}', '{"walk": 1.5}', '{"total": 1' + " " * 70_000 + "}"]
)
def test_a_batch_that_resumes_replaces_no_other_file_with_its_timings(run, done, text):
    Path("notes.json").write_text(text)
    outcome = run(*BATCH, "--resume", "--timings", "notes.json")
    assert outcome.code == 1
    assert "notes.json: exists already" in outcome.err
    assert Path("notes.json").read_text() == text


def test_frames_that_can_be_left_out_are_said_once(run, anim, here):
    for name in ("walk/f_3.obj", "runs/fast/f_2.obj"):
        Path("anim", name).write_text("v 0 0 0\nv")
    said = run(*BATCH).err
    assert said.count("--on-bad-frame skip leaves out frames that cannot be read") == 1
    again = run(*BATCH, "--resume", "--on-bad-frame", "skip")
    assert "2 failed" in said
    assert "0 failed" in again.err
    assert "on-bad-frame" not in again.err


def test_other_settings_are_done_again(run, done):
    again = run(*BATCH, "--resume", "--alpha", "0.5").err
    assert "walk           poor: " in again
    assert again.count("; replaces the result of other settings\n") == 3
    assert "walk           unchanged" in run(*BATCH, "--resume", "--alpha", "0.5").err


def test_what_is_there_is_not_lost_unasked(run, done):
    outcome = run(*BATCH)
    assert outcome.code == 1
    assert "--resume" in outcome.err
    assert "walk           poor: " in run(*BATCH, "--overwrite").err


def test_options_for_some_clips(run, anim, here):
    """The command line, then the nearest file, then the later table."""
    with Path("anim/cageik.toml").open("a") as file:
        file.write('alpha = 0.1\nbeta = 0.2\n[clips."runs/*"]\nbeta = 0.3\n')
    Path("anim/walk/cageik.toml").write_text("[extract]\nbeta = 0.4\nalign = false\n")
    Path("options.toml").write_text("[batch]\nalpha = 7\nfps = 50\n")
    assert run(*BATCH, "--config", "options.toml", "--alpha", "0.5").code == 0
    for name, beta in (("walk", 0.4), ("runs/fast", 0.3), ("face.npz", 0.2)):
        said = json.loads(
            run("report", f"out/clips/{make_result_name(name)}", "--json", "-", "-q").out
        )
        assert (said["settings"]["alpha"], said["settings"]["beta"]) == (0.5, beta)
        assert said["settings"]["align"] is (name != "walk")
        assert said["clip"]["fps"] == 50


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a = " + "[" * 20_000, "cannot be read as TOML"),
        (
            '[extract]\ncage = "a"\naccuracy = "x"\n',
            "--accuracy of a cageik.toml in its folder or above: ",
        ),
        ("[extract]\nalfa = 1\n", "has no option alfa"),
        ('[extract]\ncage = "cage.obj"\nalpha = -1\n', "alpha"),
        ('[extract]\ncage = "none.obj"\n', "none.obj: no such file"),
        ('[extract]\ncage = "cage.obj::"\n', "cage.obj: given `::` without a name behind it"),
    ],
)
def test_a_clip_whose_options_cannot_be_fails_alone(run, anim, here, text, says):
    Path("anim/walk/cageik.toml").write_text(text)
    Path("anim/cageik.toml").write_text('[clips."[rf]*"]\ncage = "cage.obj"\n')
    outcome = run(*BATCH)
    assert outcome.code == 4
    assert says in report()["walk"]["fault"]
    assert sum(entry["fault"] is None for entry in report().values()) == 2


def test_limits_are_kept_by_each_clip(run, anim, here):
    Path("anim/walk/cageik.toml").write_text('[extract]\nmax-rms = "1e-9%"\n')
    outcome = run(*BATCH, "--max-deviation", "90%")
    assert outcome.code == 3
    assert "3 done, 0 failed, 1 over a limit" in outcome.err
    (line,) = [line for line in outcome.err.splitlines() if line.startswith("walk: ")]
    assert "rms" in line
    assert [gate["passed"] for gate in report()["walk"]["gates"]] == [False, True]
    assert [gate["metric"] for gate in report()["face.npz"]["gates"]] == ["max_deviation"]
    # The command line wins, and the same results are judged anew.
    again = run(*BATCH, "--resume", "--max-rms", "90%")
    assert again.code == 0
    assert "walk           unchanged" in again.err


def test_an_earlier_report_is_a_baseline_by_names(run, done, monkeypatch):
    Path("out/report.json").rename("old.json")
    same = ("--baseline", "old.json", "--max-regression", "0%")
    read = []
    real = cageik_cli.report.limits.read_baseline
    with monkeypatch.context() as patched:
        patched.setattr(
            "cageik_cli.report.limits.read_baseline",
            lambda *given: read.append(given) or real(*given),
        )
        assert run(*BATCH, "--resume", *same).code == 0
    assert len(read) == 1
    assert run(*BATCH, "--resume", "--alpha", "10", *same).code == 3
    assert any(gate["baseline"] is not None for gate in report()["runs/fast"]["gates"])


def change_old(change):
    """Change the clips of the baseline, by name."""
    record = json.loads(Path("old.json").read_text())
    clips = {clip["name"]: clip for clip in record["clips"]}
    change(clips)
    Path("old.json").write_text(json.dumps(record | {"clips": list(clips.values())}))


def scale(clips, factor):
    summary = clips["walk"]["summary"]
    summary |= {k: factor * v for k, v in summary.items() if v and k.endswith("rms_percent")}


def copy_clip(source, target):
    shutil.copytree(source, target)


def touch_frames():
    for path in Path("anim/walk").glob("f_*.obj"):
        path.write_text(path.read_text() + "# again\n")


def touch_cage():
    Path("anim/cage.obj").write_text(Path("anim/cage.obj").read_text() + "# again\n")


def move_root():
    Path("moved").mkdir()
    Path("anim").rename("moved/anim")


def rename_with_copy():
    Path("anim/walk").rename("anim/stroll")
    copy_clip("anim/stroll", "anim/twin")


NEW, MISSING = "not in the baseline old.json", "in the baseline old.json, not in this run"
SAME = ("batch", "anim", "-o", "out", "--no-pages", "--resume")
ONE = ("report", "out/clips/walk.h5")
AGAINST = ("--baseline", "old.json")
SITUATIONS = {
    "same": (lambda: None, SAME, 0, "3 clips: 3 done"),
    "renamed": (
        lambda: Path("anim/walk").rename("anim/stroll"), SAME, 0, "; in the baseline as walk",
    ),
    "moved root": (
        move_root, ("batch", "moved", *SAME[2:]), 0, "; in the baseline as runs/fast",
    ),
    "renamed and changed": (
        lambda: (touch_frames(), Path("anim/walk").rename("anim/stroll")), SAME, 3,
        f"walk: {MISSING}",
    ),
    "missing": (lambda: shutil.rmtree("anim/walk"), SAME, 3, f"walk: {MISSING}"),
    "missing, allowed": (
        lambda: shutil.rmtree("anim/walk"), (*SAME, "--allow-missing"), 0, "2 clips: 2 done",
    ),
    "missing, new allowed": (
        lambda: shutil.rmtree("anim/walk"), (*SAME, "--allow-new"), 3, f"walk: {MISSING}",
    ),
    "new": (lambda: copy_clip("anim/walk", "anim/more"), SAME, 3, f"more: {NEW}"),
    "new, allowed": (
        lambda: copy_clip("anim/walk", "anim/more"), (*SAME, "--allow-new"), 0, "4 clips: 4 done",
    ),
    "new, missing allowed": (
        lambda: copy_clip("anim/walk", "anim/more"), (*SAME, "--allow-missing"), 3, f"more: {NEW}",
    ),
    "renamed twice": (rename_with_copy, SAME, 3, f"twin: {NEW}"),
    "duplicate names": (
        lambda: change_old(lambda clips: clips["walk"].update(name="face.npz")), SAME, 1,
        "old.json: holds two results named face.npz",
    ),
    "other frames": (touch_frames, SAME, 0, "3 clips: 3 done"),
    "other cage": (touch_cage, SAME, 0, "replaces the result of other"),
    "worse": (
        lambda: change_old(lambda clips: scale(clips, 0.5)), SAME, 3, "walk: over limit: rms",
    ),
    "better": (lambda: change_old(lambda clips: scale(clips, 2.0)), SAME, 0, "3 clips: 3 done"),
    "another schema": (
        lambda: Path("old.json").write_text('{"schema": 9, "clips": []}'), SAME, 1,
        "old.json: schema is 9, expected 1",
    ),
    "empty": (
        lambda: change_old(dict.clear), SAME, 1, "old.json: holds no result with metrics",
    ),
    "of a batch, one clip": (lambda: None, ONE, 3, f"runs/fast: {MISSING}"),
    "of a batch, one clip, allowed": (
        lambda: None, (*ONE, "-v", "--allow-missing"), 0, "its frames are those of walk in old",
    ),
    "of another clip": (
        lambda: change_old(lambda clips: [clips.pop(n) for n in ("walk", "runs/fast")]), ONE, 1,
        "old.json: holds face.npz only, neither the name nor the frames of walk.h5",
    ),
    "of another clip, allowed": (
        lambda: change_old(lambda clips: [clips.pop(n) for n in ("walk", "runs/fast")]),
        (*ONE, "--allow-new", "--allow-missing"), 1, "old.json: holds face.npz only",
    ),
    "of an earlier version": (
        lambda: change_old(lambda clips: [clip.pop("sources") for clip in clips.values()]),
        (*ONE, "-v"), 3, "old.json has no digests of frames: compared by name alone",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("prepare", "words", "code", "says"), SITUATIONS.values(), ids=SITUATIONS)
def test_the_gate_of_a_baseline_has_no_hole(run, done, prepare, words, code, says):
    Path("out/report.json").rename("old.json")
    prepare()
    outcome = run(*words, *AGAINST)
    assert outcome.code == code, outcome.err
    assert any(says in line for line in (outcome.out + outcome.err).splitlines())
    if "--no-pages" not in words or says.split(": ")[-1] not in (NEW, MISSING):
        return
    name, text = says.split(": ")
    gaps = {
        gap["name"]: gap["is_new"]
        for gap in json.loads(Path("out/report.json").read_text())["gaps"]
    }
    assert gaps[name] is (text == NEW)
    junit = ElementTree.parse("out/junit.xml").getroot()
    failed = {
        case.get("classname"): case[0].get("message")
        for case in junit.iterfind(".//testcase[failure]")
    }
    assert failed[name] == text
    for view in ("out/index.html", "out/report.md"):
        assert "not in" in Path(view).read_text()


def test_the_markdown_is_appended_to_the_steps_page(run, anim, here, monkeypatch):
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", "summary.md")
    Path("summary.md").write_text("# before\n")
    run(*BATCH)
    page = Path("summary.md").read_text()
    assert page.startswith("# before\n")
    assert page.count(Path("out/report.md").read_text()) == 1


@pytest.mark.parametrize(
    "words", [("--cage", "anim/walk/cage.obj"), ("--config", "options.toml")], ids=["typed", "file"]
)
def test_a_cage_that_an_option_names_is_no_frame(run, anim, here, words):
    Path("anim/cageik.toml").unlink()
    Path("anim/cage.obj").rename("anim/walk/cage.obj")
    Path("options.toml").write_text('[batch]\ncage = "anim/walk/cage.obj"\n')
    assert run(*BATCH, *words).code == 0
    assert report()["walk"]["clip"]["frames"] == 5


def test_a_rest_pose_may_be_a_frame(run, anim, here):
    with Path("anim/cageik.toml").open("a") as file:
        file.write('rest = "walk/f_1.obj"\n')
    assert run(*BATCH).code == 0
    assert report()["walk"]["clip"]["frames"] == 5


def test_a_dry_run_changes_nothing(run, done):
    left = Path("out/clips/walk.h5.partial")
    left.write_bytes(CHECKPOINT_MAGIC)
    run(*BATCH, "--resume", "--dry-run")
    assert left.exists()
    run(*BATCH, "--resume")
    assert not left.exists()


def test_clips_can_be_left_out(run, anim, here):
    assert run(*BATCH, "--exclude", "runs/*", "--exclude", "*.npz").code == 0
    assert list(report()) == ["walk"]
    outcome = run("batch", "anim", "-o", "none", "--exclude", "*")
    assert outcome.code == 1
    assert "all 3 clips" in outcome.err
    assert not Path("none").exists()


def test_a_folder_that_holds_no_file_is_not_in_use(run, anim, here):
    Path("out/clips/walk").mkdir(parents=True)
    assert run(*BATCH).code == 0


def test_long_names_are_in_a_column(run, anim, here):
    Path("anim/runs/fast").rename("anim/runs/the_fastest_of_all")
    lines = run(*BATCH).err.splitlines()[:3]
    assert len({line.index("poor: ") for line in lines}) == 1


def test_without_pages_there_are_none(run, anim, here):
    assert run(*BATCH, "--no-cache").code == 0
    assert report()["walk"]["page"] is None
    assert not list(Path("out").rglob("walk.html"))
    assert not Path("out", WEIGHT_CACHE_FOLDER).exists()


def test_a_dry_run_lists_what_would_be_done(run, anim, here):
    Path("anim/walk/cageik.toml").write_text("[extract]\nalfa = 1\n")
    Path("anim/runs/fast/f_1.obj").write_text("no mesh")
    outcome = run(*BATCH, "--dry-run")
    assert (outcome.code, outcome.err) == (1, "")
    assert not Path("out").exists()
    face, fast, walk = outcome.out.split("\nruns/fast\n")[0], *outcome.out.split("\nwalk\n")
    assert "3 of 18 vertices" in face
    assert "face.npz.h5" in face
    assert "would fail" in fast
    assert "has no option alfa" in walk
    assert outcome.out.splitlines()[-1] == "2 of 3 clips would fail"
    assert here == []


def test_a_limit_without_a_unit_stops_all_clips_or_its_own(run, anim, here):
    Path("anim/walk/cageik.toml").write_text("max-deviation = 3\n")
    assert run(*BATCH).code == 4
    assert "3 has no unit; give 3% " in report()["walk"]["fault"]
    Path("options.toml").write_text("[batch]\nmax-deviation = 3\n")
    for words in (("--max-deviation", "3"), ("--config", "options.toml")):
        outcome = run(*BATCH, "--resume", *words)
        assert outcome.code == 2
        assert "has no unit" in outcome.err
    Path("anim/cageik.toml").write_text('cage = "cage.obj"\nmax-deviation = 3\n')
    assert run(*BATCH, "--resume").code == 2


def test_the_reason_of_a_failure_is_printed_once(run, anim, here):
    Path("anim/walk/f_3.obj").write_text("no mesh")
    outcome = run(*BATCH)
    assert outcome.code == 4
    assert outcome.err.count("f_3.obj: 0 vertices") == 1
    (line,) = [row for row in outcome.err.splitlines() if row.startswith("  walk ")]
    assert line.split() == ["walk", "failed"]
    quiet = run(*BATCH, "--resume", "-q")
    assert quiet.code == 4
    (line,) = quiet.err.splitlines()
    assert line.startswith("walk: ")
    assert "f_3.obj: 0 vertices" in line


def test_a_dry_run_tells_what_is_there(run, done):
    Path("out/clips/walk.h5").rename("out/clips/walk.h5.partial")
    assert run(*BATCH, "--dry-run", "--resume").out.count("up to date") == 2
    assert "checkpoint" in run(*BATCH, "--dry-run", "--resume").out
    assert "would be replaced" in run(*BATCH, "--dry-run", "--resume", "--alpha", "2").out


@pytest.mark.slow
def test_processes_bind_once(run_process, anim, cache):
    outcome = run_process("-m", "cageik_cli", *BATCH, "--jobs", "2")
    assert outcome.code == 0, outcome.err
    assert len(list(cache.glob("*.weights"))) == 1
    assert not list(Path("out").rglob("*partial"))


@pytest.mark.slow
def test_every_exit_code_of_the_installed_command(run_process, anim):
    """0 done, 2 wrong usage, 3 a limit was passed, 4 some failed, 1 all did."""
    command = Path(sys.executable).with_name("cageik")

    def code(*words):
        return run_process(command, *BATCH, "-q", "--jobs", "1", *words).code

    assert code("--exclude", "runs/*") == 0
    assert code("--resume", "--max-rms", "low") == 2
    assert code("--resume", "--max-rms", "0%") == 3
    Path("anim/walk/f_3.obj").write_text("no mesh")
    assert code("--resume", "--max-rms", "0%") == 4
    Path("anim/cage.obj").write_text("no mesh")
    assert code("--resume") == 1


@pytest.fixture
def long(anim, animation):
    """A clip that takes a while."""
    np.savez(
        "anim/long.npz", verts=np.tile(animation.frames, (2000, 1, 1)), faces=animation.rest.faces
    )


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals are others there")
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGKILL])
def test_what_is_done_stays_when_a_batch_is_stopped(run_process, long, sent):
    """And nothing goes on without it."""
    words = [sys.executable, "-m", "cageik_cli", *BATCH, "--jobs", "1"]
    # A shell has what it starts in the background ignore the signal, and so would this.
    heeding = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    batch = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, preexec_fn=heeding)
    log = Path("out/clips/long.npz.h5.partial")
    while not log.exists():
        assert batch.poll() is None
        time.sleep(0.01)
    batch.send_signal(sent)
    said = batch.communicate(timeout=60)[1]
    if sent == signal.SIGINT:
        assert batch.returncode == 1
        assert said.splitlines()[-1].startswith("Error: interrupted; 1 of 4 clips")
    size = -1
    while size != log.stat().st_size:
        size = log.stat().st_size
        time.sleep(0.3)
    assert Path("out/clips/face.npz.h5").exists()
    assert not Path("out/clips/long.npz.h5").exists()
    again = run_process("-m", "cageik_cli", *BATCH, "--resume", "--jobs", "1")
    assert again.code == 0, again.err
    assert "face.npz       unchanged" in again.err
    assert not log.exists()


@pytest.mark.slow
def test_files_of_options_above_are_those_above_on_disk(run, anim, here, monkeypatch):
    Path("beside").mkdir()
    Path("beside/cageik.toml").write_text("[extract]\nnonsense = 1\n")
    Path("cageik.toml").write_text("[extract]\nalpha = 0.25\n")
    monkeypatch.chdir("beside")
    assert run("batch", "../anim", "-o", "../out").code == 0
    monkeypatch.chdir("..")
    assert read_result(Path("out/clips/walk.h5")).settings["alpha"] == 0.25


def test_what_is_typed_wins_over_what_excludes_it(run, anim, here):
    table = '[extract]\ncage = "cage.obj"\nno-cache = true\n'
    Path("anim/cageik.toml").write_text(table)
    assert run(*BATCH, "--cache", "mine").code == 0
    assert list(Path("mine").iterdir())
    outcome = run(*BATCH, "--overwrite", "--cache", "mine", "--no-cache")
    assert outcome.code == 2
    assert "--cache and --no-cache" in outcome.err


def test_options_that_contradict_a_binding_are_refused_as_extract_does(run, anim, here):
    run("bind", "--cage", "anim/cage.obj", "--rest", "anim/walk/f_1.obj", "-o", "b.h5")
    assert run(*BATCH, "--binding", "b.h5", "--coordinates", "harmonic").code == 0
    outcome = run(*BATCH, "--overwrite", "--binding", "b.h5", "--coordinates", "mean-value")
    assert outcome.code == 2
    assert "b.h5 was made with harmonic" in outcome.err


@pytest.mark.slow
def test_pages_have_pictures_once_there_are_weights(run, anim, here):
    pages = ("batch", "anim", "-o", "out", "--exclude", "[rf]*")
    run(*pages, "--no-weights")
    page = Path("out/clips/walk.html")
    bare = page.read_bytes()
    run(*pages, "--resume")
    drawn = page.read_bytes()
    assert len(drawn) > len(bare)
    run(*pages, "--resume", "--no-weights")
    assert page.read_bytes() == bare


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="names are Unicode there")
def test_names_of_any_bytes_are_told_where_a_clip_is_refused(run, anim, here):
    place = os.fsdecode(b"an\xffim")
    anim.rename(place)
    Path(place, "runs/cageik.toml").write_text("[extract]\nnonsense = 1\n")
    assert run("batch", place, "-o", "out").code == 4
    assert "an\ufffdim/runs/cageik.toml: [extract] has no option" in report()["runs/fast"]["fault"]


@pytest.mark.skipif(sys.platform != "linux", reason="names are shorter there")
def test_a_result_whose_name_would_be_too_long_has_a_shorter_one(run, anim, here):
    long = os.fsdecode(b"\xff" * 150)  # of which each becomes three bytes
    Path("anim", long).mkdir()
    Path("anim/runs").rename(Path("anim", long, "runs"))
    Path("anim/walk").rename(Path("anim", "w" * 253))
    assert run(*BATCH, "--dry-run").code == 0
    assert run(*BATCH).code == 0
    assert all(Path("out", entry["result"]).is_file() for entry in report().values())


def test_going_on_replaces_nothing_that_no_batch_has_written(run, anim, here):
    Path("out").mkdir()
    Path("out/index.html").write_text("mine")
    outcome = run(*BATCH, "--resume")
    assert outcome.code == 1
    assert "out: holds index.html" in outcome.err
    Path("out/index.html").unlink()
    np.savez("mine.npz", mine=1)
    for name, mine in (("walk", Path("mine.npz").read_bytes()), ("runs/fast", hdf5_of("mine"))):
        Path("out/clips").mkdir(parents=True, exist_ok=True)
        Path("out/clips", make_result_name(name)).write_bytes(mine)
    assert run(*BATCH, "--resume").code == 4
    assert Path("out/clips/walk.h5").read_bytes() == Path("mine.npz").read_bytes()
    assert "runs_fast.h5: is not a result" in report()["runs/fast"]["fault"]
    assert run(*BATCH, "--overwrite").code == 0


def hdf5_of(name):
    """The bytes of an HDF5 file that is no result."""
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        file[name] = 1
    return buffer.getvalue()


@pytest.mark.parametrize("place", ["out", "out/clips/runs"])
def test_results_are_no_clips(run, done, place):
    outcome = run("batch", place, "-o", "out", "--overwrite")
    assert outcome.code == 2
    assert "-o" in outcome.err
