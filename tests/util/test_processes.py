"""Calls in subprocesses give what they give here, whatever becomes of the processes."""

import ctypes
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.util import processes
from cageik_cli.util.processes import (
    Program,
    ProgramError,
    Subprocess,
    SubprocessError,
    call_in_subprocesses,
)

on_linux = pytest.mark.skipif(sys.platform != "linux", reason="limits are others there")
with_signals = pytest.mark.skipif(sys.platform == "win32", reason="there are no such signals")

PARENT = """
import sys
from cageik_cli.util.processes import Subprocess
from tests.util import test_processes

if __name__ == "__main__":
    child = Subprocess()
    print(child.call(test_processes.find_own_number), flush=True)
    child.call(getattr(test_processes, sys.argv[1]), 60)
"""


def find_own_number():
    return os.getpid()


def describe(number):
    """The number, and the process that was asked."""
    return number, os.getpid()


def wait(seconds):
    """Return after some seconds."""
    time.sleep(seconds)
    return seconds


def wait_like_a_library(seconds):
    """Let no thread of the interpreter run meanwhile."""
    ctypes.PyDLL(None).sleep(seconds)


def wait_for_writer(path):
    """Wait for what no one writes, within a limit that is next to nothing."""
    processes.MAX_WAIT_RATIO = 0
    processes.limit_process(1 << 30, 1)
    return Path(path).read_bytes()


def compute_without_end():
    processes.limit_process(1 << 30, 1)
    while True:
        pass


def fill_memory():
    processes.limit_process(1 << 30, 10)
    return len(bytearray(2 << 30))


def die(number=None, parent=None):
    """End this process, unless it is the parent."""
    if os.getpid() == parent:
        return number
    os.kill(os.getpid(), signal.SIGKILL)
    return None


def run_out_of_memory(number, parent):
    if os.getpid() == parent:
        return number
    raise MemoryError


def leave():
    os._exit(3)


def fail(number):
    """No process can say what is wrong with 2."""
    if number == 2:
        raise ValueError("2 is wrong")
    return number


def add(columns):
    """Sum rows of a matrix that may be a view."""
    return columns @ np.arange(3.0), columns.flags.c_contiguous


def write_to_all():
    """Write as Python and as a library do."""
    print("printed", flush=True)
    os.write(1, b"to output, ")
    os.write(2, b"to error")


def test_calls_beyond_the_first_are_made_in_other_processes_as_many_as_are_allowed():
    found = list(call_in_subprocesses(describe, [(k,) for k in range(4)], 3))
    assert [number for number, _ in found] == [0, 1, 2, 3]
    is_here = [process == os.getpid() for _, process in found]
    assert is_here == [True, False, False, True]


@pytest.mark.parametrize("count", [1, 2])
def test_arrays_have_the_same_layout_in_every_process(count):
    view = np.random.default_rng(0).normal(size=(6, 4))[::2, :3]
    (first, is_first), (second, is_second) = call_in_subprocesses(add, [(view,), (view,)], count)
    assert first.tobytes() == second.tobytes()
    assert (is_first, is_second) == (True, True)


def test_a_call_that_fails_there_fails_here_with_its_own_error():
    calls = call_in_subprocesses(fail, [(1,), (2,)], 2)
    assert next(calls) == 1
    with pytest.raises(ValueError, match="2 is wrong"):
        next(calls)


@pytest.mark.parametrize(
    ("name", "value"), [("executable", ""), ("frozen", True)], ids=["no program", "frozen"]
)
def test_without_a_program_for_processes_all_calls_are_made_here(monkeypatch, name, value):
    monkeypatch.setattr(sys, name, value, raising=False)
    notes = []
    found = call_in_subprocesses(describe, [(0,), (1,)], 2, notes.append)
    assert {process for _, process in found} == {os.getpid()}
    assert notes == [
        "there is no Python that could be started; there are fewer to share the work, which takes "
        "longer"
    ]


@with_signals
def test_a_program_that_is_not_there_is_made_up_for(monkeypatch):
    monkeypatch.setattr(multiprocessing.spawn, "_python_exe", b"/no/such/program")
    notes = []
    found = call_in_subprocesses(describe, [(0,), (1,)], 2, notes.append)
    assert {process for _, process in found} == {os.getpid()}
    assert "ends with exit code 255" in notes[0]


@with_signals
@pytest.mark.parametrize(
    ("function", "end"), [(die, "ends with SIGKILL"), (run_out_of_memory, "runs out of memory")]
)
def test_a_process_that_fails_is_made_up_for_and_named(function, end):
    notes, here = [], os.getpid()
    calls = [(1, here), (2, here)]
    assert list(call_in_subprocesses(function, calls, 2, notes.append)) == [1, 2]
    assert notes == [f"a process that shares the work {end}; its part is done again"]


def test_processes_end_with_a_caller_that_wants_no_more():
    calls = call_in_subprocesses(wait, [(0,), (60,)], 2)
    next(calls)
    assert len(multiprocessing.active_children()) == 1
    calls.close()
    assert multiprocessing.active_children() == []


def test_no_call_gives_no_result():
    assert list(call_in_subprocesses(describe, [], 2)) == []


@with_signals
@pytest.mark.parametrize(
    ("function", "text", "name"),
    [(die, "ends with SIGKILL", "SIGKILL"), (leave, "ends with exit code 3", "")],
)
def test_the_end_of_a_process_is_described(function, text, name):
    with Subprocess() as process, pytest.raises(SubprocessError, match=text) as caught:
        process.call(function)
    assert caught.value.signal == name


@with_signals
def test_a_process_that_ended_between_calls_is_noticed():
    with Subprocess() as process:
        os.kill(process.call(find_own_number), signal.SIGKILL)
        with pytest.raises(SubprocessError, match="SIGKILL"):
            process.call(wait, 60)


def test_an_exception_of_a_call_is_raised_here_and_the_process_goes_on():
    with Subprocess() as process:
        with pytest.raises(ValueError, match="2 is wrong"):
            process.call(fail, 2)
        assert process.call(fail, 1) == 1


def test_a_call_that_takes_too_long_is_given_up_and_ended():
    with Subprocess() as process:
        process.call(find_own_number)
        with pytest.raises(TimeoutError):
            process.call(wait, 60, seconds=0.05)
    assert multiprocessing.active_children() == []


@on_linux
def test_limits_end_a_process_that_waits_or_computes_too_long(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for name, function, *arguments in (
        ("SIGALRM", wait_for_writer, tmp_path / "pipe"),
        ("SIGXCPU", compute_without_end),
    ):
        with Subprocess() as process, pytest.raises(SubprocessError, match=f"ends with {name}"):
            process.call(function, *arguments)


@on_linux
def test_memory_beyond_the_limit_is_refused():
    with Subprocess() as process, pytest.raises(MemoryError):
        process.call(fill_memory)


@pytest.mark.parametrize(("is_silent", "errors"), [(False, "to error"), (True, "")])
def test_a_process_prints_nothing_among_the_data(capfd, is_silent, errors):
    with Subprocess(is_silent=is_silent) as process:
        process.call(write_to_all)
    assert capfd.readouterr() == ("", errors)


@on_linux
@pytest.mark.parametrize("function", [wait, wait_like_a_library])
def test_a_process_ends_with_a_parent_that_is_killed(tmp_path, function):
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    words = [sys.executable, str(script), function.__name__]
    found = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    with subprocess.Popen(words, stdout=subprocess.PIPE, env=found, text=True) as parent:
        child = int(parent.stdout.readline())
        time.sleep(0.1)  # the call begins
        assert is_running(child)
        parent.kill()
    end = time.monotonic() + 2
    while is_running(child) and time.monotonic() < end:
        time.sleep(0.01)
    assert not is_running(child)


def is_running(number):
    """Whether a process is there, and not only waits for its end to be read."""
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_signal_without_a_name_is_said_by_its_number():
    assert str(SubprocessError(-35)) == "ends with signal 35"


COPY = "import sys; open(sys.argv[1], 'wb').write(sys.stdin.buffer.read())"


def run_python(code, *words):
    return Program([sys.executable, "-c", code, *words])


def test_a_program_gets_all_that_it_is_fed(tmp_path, capfd):
    data = os.urandom(1 << 20)
    with run_python(f"print('said'); {COPY}", str(tmp_path / "copy")) as program:
        for start in range(0, len(data), 1 << 18):
            program.feed(data[start : start + (1 << 18)])
        program.finish()
    assert (tmp_path / "copy").read_bytes() == data
    assert capfd.readouterr() == ("", "")


def test_words_of_a_program_are_no_commands(tmp_path):
    name = tmp_path / "a b; touch c"
    with run_python(COPY, str(name)) as program:
        program.finish()
    assert [file.name for file in tmp_path.iterdir()] == [name.name]


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("import sys; sys.stdin.read(); sys.exit('no\\n\\nroom')", "exit code 1: no; room$"),
        ("import sys; sys.stdin.read(); sys.exit('a' * 9999)", "exit code 1: a{1999}$"),
        ("import sys; sys.stdin.read(); sys.exit(7)", "exit code 7$"),
    ],
)
def test_a_program_that_fails_says_how(code, said):
    with run_python(code) as program:
        program.feed(b"data")
        with pytest.raises(ProgramError, match=said):
            program.finish()


def test_a_program_that_ends_early_takes_no_more():
    code = "import sys; sys.exit('full')"
    with run_python(code) as program, pytest.raises(ProgramError, match="exit code 1: full"):
        program.feed(bytes(1 << 24))


def test_a_program_is_ended_whatever_it_does():
    start = time.monotonic()
    with pytest.raises(KeyError), run_python("import time; time.sleep(60)") as program:
        raise KeyError
    assert program._process.returncode not in (None, 0)
    assert time.monotonic() - start < 30


def test_a_program_that_is_not_there_cannot_be_started(tmp_path):
    with pytest.raises(OSError, match="none"):
        Program([str(tmp_path / "none")])
