"""Calls in other processes give what they give here, whatever becomes of the processes."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from cageik_cli.util.processes import call_in_subprocesses


def describe(number):
    """The number, and the process that was asked."""
    return number, os.getpid()


def wait(seconds):
    """Return after some seconds."""
    time.sleep(seconds)
    return seconds


def fail(number):
    """No process can say what is wrong with 2."""
    if number == 2:
        raise ValueError("2 is wrong")
    return number


def add(columns):
    """Sum rows of a matrix that may be a view."""
    return columns @ np.arange(3.0), columns.flags.c_contiguous


def test_calls_beyond_the_first_are_made_in_other_processes_as_many_as_are_allowed():
    found = list(call_in_subprocesses(describe, [(k,) for k in range(4)], 3))
    assert [number for number, _ in found] == [0, 1, 2, 3]
    is_here = [process == os.getpid() for _, process in found]
    assert is_here == [True, False, False, True]


@pytest.mark.parametrize("processes", [1, 2])
def test_arrays_have_the_same_layout_in_every_process(processes):
    view = np.random.default_rng(0).normal(size=(6, 4))[::2, :3]
    (first, is_first), (second, is_second) = call_in_subprocesses(
        add, [(view,), (view,)], processes
    )
    assert first.tobytes() == second.tobytes()
    assert (is_first, is_second) == (True, True)


def test_a_call_that_fails_there_fails_here_with_its_own_error():
    calls = call_in_subprocesses(fail, [(1,), (2,)], 2)
    assert next(calls) == 1
    with pytest.raises(ValueError, match="2 is wrong"):
        next(calls)


@pytest.mark.parametrize("name", ["", "/no/such/program"])
def test_without_a_program_for_processes_all_calls_are_made_here(monkeypatch, name):
    monkeypatch.setattr(sys, "executable", name)
    assert {process for _, process in call_in_subprocesses(describe, [(0,), (1,)], 2)} == {
        os.getpid()
    }


def test_a_frozen_program_is_not_started_again(monkeypatch):
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    assert {process for _, process in call_in_subprocesses(describe, [(0,), (1,)], 2)} == {
        os.getpid()
    }


def test_processes_end_with_a_caller_that_wants_no_more(monkeypatch):
    started = []
    popen = subprocess.Popen

    def start(*words, **options):
        started.append(popen(*words, **options))
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", start)
    calls = call_in_subprocesses(wait, [(0,), (60,)], 2)
    next(calls)
    calls.close()
    assert started[0].returncode == -signal.SIGKILL


def test_no_call_gives_no_result():
    assert list(call_in_subprocesses(describe, [], 2)) == []
