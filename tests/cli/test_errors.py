"""Whatever fails becomes one sentence and exit code 1, and what is on disk stays."""

import errno
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from cageik_cli.cli import output

CASES = json.loads(
    (Path(__file__).resolve().parents[2] / "data_fixtures" / "broken" / "cases.json").read_text()
)
TYPED = ("extract", "frames", "--cage", "cage.obj")


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_bad_inputs(run, fixtures_folder, tmp_path, monkeypatch, coarse_panels, case):
    """Each gets its exit code and its sentence; an old result and the inputs stay as they are."""
    folder = tmp_path / "copy"
    shutil.copytree(fixtures_folder / "broken" / case["name"], folder)
    monkeypatch.chdir(folder)
    extracts, succeeds = case["arguments"][0] == "extract", case["exit"] == 0
    words = [*case["arguments"]]
    if extracts:
        (folder / "cages.h5").write_text("old")
        words += ["--overwrite"]
    before = contents(folder)
    outcome = run(*words, *(["-v"] if extracts else []))
    assert outcome.code == case["exit"]
    for fragment in case["says"]:
        assert fragment in outcome.err.lower()
    after = contents(folder)
    if succeeds:
        assert after.pop(folder / "cages.h5") != before.pop(folder / "cages.h5")
        rows = [line.split(maxsplit=1) for line in outcome.err.splitlines()]
        noted = [text for label, text in rows if label in ("note", "warning")]
        assert len([text for text in noted if "states its unit" not in text]) == 1
    else:
        assert (outcome.out, len(outcome.err.splitlines())) == ("", 1)
        assert outcome.err.startswith("Error: ")
        assert "internal error" not in outcome.err
        assert "Traceback" not in outcome.err
        assert str(tmp_path) not in outcome.err
    assert after == before


@pytest.mark.slow
def test_a_bad_input_in_a_process_of_its_own(run_process, fixtures_folder, tmp_path):
    """Nothing is left on stderr at the end of the interpreter either."""
    shutil.copytree(fixtures_folder / "broken" / "nan_frame", tmp_path, dirs_exist_ok=True)
    outcome = run_process("-m", "cageik_cli", *TYPED, cwd=tmp_path)
    assert (outcome.code, outcome.out) == (1, "")
    message = f"Error: {Path('frames/frame_2.obj')}: vertex 4 is (0, nan, 1)"
    assert outcome.err.startswith(message)
    assert len(outcome.err.splitlines()) == 1


@pytest.fixture
def failing(monkeypatch):
    """Let the extraction fail with an error."""

    def with_error(error):
        def extract(settings, watch):
            raise error

        monkeypatch.setattr("cageik_cli.run.extraction.extract", extract)

    return with_error


FAILURES = {
    "interrupted": (KeyboardInterrupt(), "interrupted"),
    "disk full": (
        OSError(errno.ENOSPC, "No space left on device", "cages.h5"),
        "cages.h5: No space left on device",
    ),
    "no name": (OSError(errno.EIO, "Input/output error"), "the system: Input/output error"),
    "no number": (OSError("odd"), "the system: odd"),
    "memory": (MemoryError(), "out of memory; use a coarser cage, or a smaller --memory"),
    "unexpected": (
        ZeroDivisionError("by\nzero"),
        "internal error (ZeroDivisionError: by zero); please report it with the output "
        "of the same command with -vv",
    ),
}


@pytest.mark.parametrize(("error", "sentence"), FAILURES.values(), ids=FAILURES)
def test_every_failure_is_one_sentence(run, folder, failing, error, sentence):
    failing(error)
    outcome = run(*TYPED)
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err == f"Error: {sentence}\n"


def test_a_reader_that_has_gone_hears_nothing(run, folder, failing):
    failing(BrokenPipeError(errno.EPIPE, "Broken pipe"))
    outcome = run(*TYPED)
    assert (outcome.code, outcome.out, outcome.err) == (1, "", "")


@pytest.mark.parametrize(("option", "traced"), [("-q", False), ("-v", False), ("-vv", True)])
def test_a_traceback_is_shown_with_vv_alone(run, folder, failing, option, traced):
    failing(ZeroDivisionError("by zero"))
    outcome = run(*TYPED, option)
    assert outcome.code == 1
    assert outcome.err.splitlines()[-1].startswith("Error: internal error")
    assert ("Traceback (most recent call last)" in outcome.err) is traced
    assert ("raise error" in outcome.err) is traced


def test_an_input_error_is_traced_too(run, folder):
    outcome = run("extract", "nowhere", "--cage", "cage.obj", "-vv")
    assert "Traceback" in outcome.err
    assert outcome.err.splitlines()[-1] == (
        "Error: nowhere: no such file or folder; check the path"
    )


@pytest.mark.slow
@pytest.mark.parametrize(("room", "kept"), [(500, False), (30_000, True)])
def test_a_full_disk_leaves_the_old_result(run_process, fixtures_folder, tmp_path, room, kept):
    """A limit on the size of a file stands for the end of the disk."""
    resource = pytest.importorskip("resource")
    (tmp_path / "cages.h5").write_text("old")
    posed = fixtures_folder / "posed" / "surface"
    outcome = run_process(
        "-m", "cageik_cli", "extract", posed / "frames", "--cage", posed / "cage.obj",
        "--overwrite", cwd=tmp_path,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (room, room)),
    )  # fmt: skip
    assert outcome.code == 1
    assert outcome.err.startswith("Error: cages.h5: cannot be written (")
    assert len(outcome.err.splitlines()) == 1
    left = sorted(item.name for item in tmp_path.iterdir())
    assert left == ["cages.h5", "cages.h5.partial"][: 2 if kept else 1]
    assert ("frames are kept in cages.h5.partial" in outcome.err) is kept
    assert (tmp_path / "cages.h5").read_text() == "old"


@pytest.fixture
def odd_names(folder):
    """The little animation in files whose names are not UTF-8."""
    for k in range(1, 6):
        path = folder / "frames" / f"frame_{k}.obj"
        try:
            path.rename(os.fsdecode(os.fsencode(folder / "frames") + b"/p\xff_%d.obj" % k))
        except OSError:
            pytest.skip("this system's names are text")
    (folder / "cage.obj").rename(os.fsdecode(b"c\xff.obj"))
    return folder


@pytest.mark.slow
def test_names_that_are_no_text_are_read_stored_and_shown(run, run_process, odd_names):
    cage, result = (os.fsdecode(name) for name in (b"c\xff.obj", b"r\xff.h5"))
    done = run_process(
        "-m", "cageik_cli", "extract", "frames", "--cage", cage, "-o", result, "-v", cwd=odd_names
    )
    assert (done.code, done.out) == (0, ""), done.err
    for words in (["report", result, "--csv", "r.csv"], ["info", result], ["info", cage],
                  ["info", "frames"]):  # fmt: skip
        shown = run_process("-m", "cageik_cli", *words, cwd=odd_names)
        assert (shown.code, shown.err) == (0, "")
        assert "\ufffd" in shown.out
    record = json.loads(run("report", result, "--json", "-", "-q").out)
    assert [frame["name"] for frame in record["frames"]] == [
        f"p\ufffd_{k}.obj" for k in range(1, 6)
    ]
    assert record["sources"]["cage"]["name"] == "c\ufffd.obj"
    assert record["result"] == "r\ufffd.h5"
    assert Path("r.csv").read_text(encoding="utf-8").count("p\ufffd_") == 5


@pytest.mark.slow
def test_a_fault_in_a_file_whose_name_is_no_text_is_a_sentence(run_process, odd_names):
    cage = os.fsdecode(b"c\xff.obj")
    Path(cage).write_text("v 1 2\n")
    for words in (["extract", "frames", "--cage", cage], ["info", cage],
                  ["report", os.fsdecode(b"no\xff.h5")]):  # fmt: skip
        outcome = run_process("-m", "cageik_cli", *words, cwd=odd_names)
        assert (outcome.code, outcome.out) == (1, "")
        assert outcome.err.startswith("Error: ")
        assert "internal error" not in outcome.err
        assert len(outcome.err.splitlines()) == 1


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="the shell's `2>&-`")
@pytest.mark.parametrize("stream", [1, 2])
def test_a_closed_stream_changes_no_exit_code(run_process, folder, stream):
    closed = {"cwd": folder, "preexec_fn": lambda: os.close(stream)}
    assert run_process("-m", "cageik_cli", *TYPED, **closed).code == 0
    for words in (["report"], ["info", "cages.h5"]):
        outcome = run_process("-m", "cageik_cli", *words, **closed)
        assert outcome.code == 0
        assert "Traceback" not in outcome.out + outcome.err
    asked = run_process("-m", "cageik_cli", "report", "--json", "-", **closed)
    assert asked.code == (stream == 1)
    for words in (TYPED, ["report", "nowhere.h5"], ["info", "nowhere"]):
        outcome = run_process("-m", "cageik_cli", *words, **closed)
        assert outcome.code == 1
        assert "Traceback" not in outcome.out + outcome.err


CLOSED_STREAMS = """
import os, sys
from cageik_cli.__main__ import _open_closed_streams
kept = os.dup(2)
for stream in map(int, sys.argv[1:]):
    os.close(stream)
_open_closed_streams()
found = [os.fstat(stream).st_rdev for stream in map(int, sys.argv[1:])]
nowhere, after = os.stat(os.devnull).st_rdev, os.open(os.devnull, os.O_RDONLY)
os.write(kept, f"{[one == nowhere for one in found]} {after > 2}".encode())
"""


@pytest.mark.skipif(os.name != "posix", reason="devices are others there")
@pytest.mark.parametrize("streams", [(), (0,), (1,), (2,), (0, 1, 2), (1, 2)])
def test_files_do_not_take_the_place_of_closed_streams(run_process, streams):
    outcome = run_process("-c", CLOSED_STREAMS, *map(str, streams))
    assert outcome.err == f"{[True] * len(streams)} True"


@pytest.mark.parametrize(
    "words",
    [
        ("report", "cages.h5", "--json", "-"),
        ("report", "cages.h5", "--csv", "-"),
        ("check", "--cage", "cage.obj", "--json", "-"),
        ("cage", "cage.obj", "-o", "built.obj", "--json", "-"),
        ("pose", "cages.h5", "handles.json", "-o", "edit.h5", "--json", "-"),
        ("pose", "cages.h5", "handles.json", "-o", "edit.h5", "--plot", "-"),
    ],
)
def test_a_closed_output_that_is_asked_for_is_refused_before_any_work(
    run, extracted, monkeypatch, words
):
    Path("handles.json").write_text('{"handles": []}')
    monkeypatch.setattr(output, "sys", SimpleNamespace(stdout=None, stderr=sys.stderr))
    outcome = run(*words)
    assert (outcome.code, outcome.err) == (1, "Error: -: standard output is closed; name a file\n")
    assert not Path("built.obj").exists()
    assert not Path("edit.h5").exists()


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="the shell's pipes")
@pytest.mark.parametrize(
    "words", [["report"], ["report", "--json", "-"], ["report", "--csv", "-"], ["info", "cages.h5"]]
)
def test_a_reader_that_goes_early_sees_no_traceback(run, folder, words):
    assert run(*TYPED, "-q").code == 0
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "cageik_cli", *words], stdout=writing, stderr=subprocess.PIPE
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (1, b"")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no such device")
@pytest.mark.parametrize(
    "words",
    [
        ["report"],
        pytest.param(["report", "--json", "-"], marks=pytest.mark.slow),
        pytest.param(["info", "cages.h5"], marks=pytest.mark.slow),
    ],
)
def test_an_answer_that_cannot_be_written_is_a_failure(extracted, words):
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "cageik_cli", *words],
            stdout=full, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert done.stderr.startswith("Error: ")
    assert "No space left on device" in done.stderr
    assert len(done.stderr.splitlines()) == 1
