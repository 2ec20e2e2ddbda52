"""Calls that are tried in another process: how it ends becomes a sentence."""

import multiprocessing
import os
import sys
import threading

import pytest

from cageik_cli.util import processes, trial
from cageik_cli.util.trial import Trials

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals are others there")


def succeed(text):
    print("what a library prints")


def find(text):
    print("what a library prints")
    return f"is {text}"


def fail(text):
    raise ValueError(text)


def abort(text):
    os.abort()


def fill(text):
    bytearray(8 << 30)


def fill_like_a_library(text):
    raise RuntimeError("std::bad_alloc")


def leave(text):
    os._exit(3)


def wait(text):
    """Wait for a lock that is not given back, within a limit that is next to nothing."""
    processes.MAX_WAIT_RATIO = 0
    trial.trials.allow(1)
    lock = threading.Lock()
    lock.acquire()
    lock.acquire()


@pytest.fixture
def trials():
    made = Trials()
    made.are_wanted = True
    return made


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        (succeed, ""),
        (fail, ""),
        (find, "is wróng"),
        (abort, "is damaged: abc ends with SIGABRT on it; export it again"),
        (leave, ""),
        (wait, "is damaged: abc takes too long on it; export it again"),
        (fill_like_a_library, "is damaged: abc takes too much memory on it; export it again"),
        pytest.param(
            fill,
            "is damaged: abc takes too much memory on it; export it again",
            marks=pytest.mark.skipif(sys.platform != "linux", reason="limits are others there"),
        ),
    ],
)
def test_the_end_of_a_trial_is_a_sentence(trials, call, expected):
    assert trials.find_fault("abc", call, "wróng", key="a") == expected


def test_what_has_passed_is_not_tried_again(trials, tmp_path):
    def find(path):
        return trials.find_fault("abc", count, str(path), key=path.name)

    for name in ("a", "b", "a"):
        assert find(tmp_path / name) == ""
    assert [(tmp_path / name).stat().st_size for name in "ab"] == [1, 1]
    assert trials.find_fault("abc", count, str(tmp_path / "a"), key="changed") == ""
    assert (tmp_path / "a").stat().st_size == 2


def count(path):
    with open(path, "a") as file:
        file.write(".")


def test_a_library_is_silent_where_calls_are_tried(trials, capfd):
    with trials.silence():
        os.write(2, b"from a library")
    os.write(2, b"from us")
    with Trials().silence():
        os.write(2, b", and all if nothing is tried")
    assert capfd.readouterr().err == "from us, and all if nothing is tried"


def test_a_failure_ends_the_silence(trials, capfd):
    with pytest.raises(ValueError, match="wrong"), trials.silence():
        raise ValueError("wrong")
    os.write(2, b"from us")
    assert capfd.readouterr().err == "from us"


def test_a_closed_standard_error_stays_closed(trials, monkeypatch, capfd):
    """Nothing is put in its place: what is written goes where it went."""

    def refuse(descriptor):
        raise OSError

    with monkeypatch.context() as patch:
        patch.setattr(os, "dup", refuse)
        with trials.silence():
            os.write(2, b"within, ")
        os.write(2, b"and after")
    assert capfd.readouterr().err == "within, and after"


def test_nothing_is_tried_that_is_not_wanted():
    assert Trials().find_fault("abc", abort, "", key="a") == ""


def test_a_process_that_cannot_be_started_is_no_fault(trials, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(multiprocessing.spawn, "_python_exe", b"/nowhere/python")
        assert trials.find_fault("abc", abort, "", key="a") == ""
    monkeypatch.setattr(sys, "executable", "")
    assert trials.find_fault("abc", abort, "", key="a") == ""


def test_two_threads_give_standard_error_back(trials, capfd):
    """The first that ends leaves the other silent; the last ends the silence."""
    first, second = trials.silence(), trials.silence()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    os.write(2, b"of a library\n")
    second.__exit__(None, None, None)
    os.write(2, b"of the program\n")
    assert capfd.readouterr().err == "of the program\n"


def try_there():
    return trial.trials.find_fault("abc", abort, "", key="a")


@pytest.mark.parametrize("are_wanted", [True, False])
def test_a_subprocess_tries_what_its_parent_would_try(monkeypatch, are_wanted):
    """As the processes of a batch do."""
    monkeypatch.setattr(trial.trials, "are_wanted", are_wanted)
    with processes.Subprocess() as process:
        found = process.call(try_there)
    assert found == (
        "is damaged: abc ends with SIGABRT on it; export it again" if are_wanted else ""
    )
