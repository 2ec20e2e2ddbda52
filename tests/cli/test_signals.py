"""A run that is told to end leaves nothing unfinished; one that is killed leaves it to the next."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cageik_cli.cli.group import interrupt_on_termination

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of this system")

SLOW = """
import signal, sys, time
from cageik_cli.formats import npz as writer
def append(self, frames):
    print("writing", flush=True)
    time.sleep(60)
writer.Writer.append = append
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # these tests may run under nohup
from cageik_cli.cli import main
main()
"""


def end_while_writing(number):
    """Start an export, and send it a signal while it writes; return its exit code and stderr."""
    words = [sys.executable, "-c", SLOW, "export", "cages.h5", "a.npz"]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "writing\n"
        process.send_signal(number)
        _, said = process.communicate(timeout=60)
    return process.returncode, said


@pytest.mark.parametrize(
    "name",
    ["SIGTERM", *(pytest.param(name, marks=pytest.mark.slow) for name in ("SIGINT", "SIGHUP"))],
)
def test_a_signal_ends_a_run_as_ctrl_c_does(extracted, name):
    assert end_while_writing(getattr(signal, name)) == (1, "Error: interrupted\n")
    assert not [path for path in Path().iterdir() if "partial" in path.name]
    assert not Path("a.npz").exists()


def test_a_run_under_nohup_goes_on():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with interrupt_on_termination():
            assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
            assert signal.getsignal(signal.SIGTERM) != signal.SIG_DFL
        assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("quiet", [[], pytest.param(["-q"], marks=pytest.mark.slow)])
def test_what_a_killed_run_left_is_removed_by_the_next(run, extracted, quiet):
    assert end_while_writing(signal.SIGKILL)[0] == -9
    (left,) = (path for path in Path().iterdir() if "partial" in path.name)
    outcome = run("export", "cages.h5", "a.npz", *quiet)
    assert outcome.code == 0
    assert not left.exists()
    assert (f"note: {left}: removed" in outcome.err) == (not quiet)


@pytest.mark.parametrize("out", ["nowhere/../x/c_####.obj", "nowhere/../c.npz", "nowhere/../x"])
def test_a_folder_on_the_way_that_is_missing_is_refused_before_any_work(run, extracted, out):
    before = sorted(Path().rglob("*"))
    outcome = run("export", "cages.h5", out)
    assert outcome.code == 1
    assert "the folder nowhere" in outcome.err
    assert sorted(Path().rglob("*")) == before


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no such device")
@pytest.mark.parametrize(
    ("words", "written"),
    [
        (["extract", "frames", "--cage", "cage.obj", "-o", "b.h5", "-v"], "b.h5"),
        pytest.param(
            ["batch", "frames", "--cage", "cage.obj", "-o", "out", "--jobs", "1"],
            "out/report.json",
            marks=pytest.mark.slow,
        ),
        pytest.param(["export", "cages.h5", "b.npz"], "b.npz", marks=pytest.mark.slow),
    ],
)
def test_messages_that_cannot_be_written_change_no_exit_code(extracted, words, written):
    with open("/dev/full", "w") as full:
        done = subprocess.run([sys.executable, "-m", "cageik_cli", *words], stderr=full)
    assert done.returncode == 0
    assert Path(written).exists()


def test_a_library_that_cannot_be_loaded_is_no_internal_error(run, extracted, monkeypatch):
    def fail(*words):
        raise ImportError("libx.so: cannot open shared object file: Error 24")

    monkeypatch.setattr("cageik_cli.run.info.describe_files", fail)
    outcome = run("info", "cages.h5")
    assert outcome.code == 1
    assert "a library cannot be loaded (libx.so" in outcome.err
    assert "internal error" not in outcome.err
