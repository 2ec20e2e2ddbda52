"""Runs of a command in forks of this process, which has imported everything already.

A run costs a tenth of a second instead of a second, and makes hardly any call for the interpreter
itself. `run_cold` starts an interpreter instead, to see what fails while it imports.
"""

import atexit
import multiprocessing
import os
import re
import select
import signal
import socket
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import NoReturn

from cageik_cli.util import processes
from tests.faults.interception import OPENS, SIZES, WRITES, Listener, StoppedCall, install_filter

ROOT = Path(__file__).resolve().parents[2]
KILL, FULL = "KILL", "FULL"
"""Instead of an error of one call: its process is killed; or the disk is full from there."""

MAX_SECONDS = 60.0
"""Seconds after which a run is said to hang."""

MAX_STEP = 1.0
"""Seconds of waiting that count at once: a machine that stood still in between does not count."""

_RANDOM = re.compile(
    r"(?<=\.)[0-9a-f]{24}(?=\.)|(?<=\.)\w{8}(?=\.partial)|(?<=\.partial\.)\w{6}$"
    r"|(?<=/)#\d+|(?<=tmp/tmp)\w{8}|(?<=pymp-)\w{8}"
)
"""Parts of names that differ between runs: of unfinished and of temporary files."""


@dataclass(frozen=True, order=True)
class Point:
    """The `count`-th call of a run of a kind about a file, from 1."""

    call: str
    path: str
    count: int


@dataclass
class Run:
    """How a run ended.

    Attributes
    ----------
    code : int
        Its exit code; minus the signal that killed it.
    points : list of Point
        Its calls about files of its own, in order.
    foreign : list of Point
        Those about files of the interpreter, of installed packages and of the system.
    is_hit : bool
        Whether the call that was to fail was made.
    """

    code: int = 0
    output: bytes = b""
    said: str = ""
    points: list[Point] = field(default_factory=list)
    foreign: list[Point] = field(default_factory=list)
    is_hit: bool = False


def make_environment(folder: Path) -> dict[str, str]:
    """Return the variables of a run whose files are all below a folder."""
    home = str(folder / "home")
    return {
        "CAGEIK_CACHE": str(folder / "cache"), "TMPDIR": str(folder / "tmp"), "HOME": home,
        "XDG_CONFIG_HOME": home, "XDG_CACHE_HOME": home,
        "MPLCONFIGDIR": str(folder.parent / "matplotlib"), "OPENBLAS_NUM_THREADS": "1",
        "PYTHONDONTWRITEBYTECODE": "1", "PYTHONPATH": str(ROOT),
    }  # fmt: skip


def run_warm(
    folder: Path, main: str, words: tuple[str, ...],
    point: Point | None = None, fault: str = "", kill_after: float | None = None,
) -> Run:  # fmt: skip
    """Run `main`, MODULE:FUNCTION, in a fork; let one call fail, or kill it after some seconds."""

    def become() -> NoReturn:
        sys.argv = ["cageik", *words]
        _leave(_call_main(main))

    return _supervise(folder, become, point, fault, kill_after)


def learn_modules(folder: Path, main: str, words: tuple[str, ...]) -> list[str]:
    """Return the names of the modules that a run imports."""
    names = folder / "modules"

    def become() -> NoReturn:
        sys.argv = ["cageik", *words]
        code = _call_main(main)
        names.write_text("\n".join(sys.modules))
        _leave(code)

    _supervise(folder, become, None, "", None)
    return names.read_text().splitlines()


def run_cold(
    folder: Path, words: tuple[str, ...], point: Point | None = None, fault: str = ""
) -> Run:
    """Run `python -m cageik_cli` in an interpreter of its own; let one call fail."""

    def become() -> NoReturn:
        os.execv(sys.executable, [sys.executable, "-m", "cageik_cli", *words])

    return _supervise(folder, become, point, fault, None)


def _supervise(
    folder: Path, become: Callable[[], NoReturn], point: Point | None, fault: str,
    kill_after: float | None,
) -> Run:  # fmt: skip
    ours, theirs = socket.socketpair()
    process = os.fork()
    if process == 0:
        ours.close()
        _enter(folder, theirs, become)
    theirs.close()
    _, descriptors, _, _ = socket.recv_fds(ours, 1, 1)
    ours.close()
    run, listener = Run(), Listener(descriptors[0])
    seconds = MAX_SECONDS if kill_after is None else kill_after
    try:
        is_in_time = _answer_calls(listener, folder, run, (point, fault), seconds)
        if not is_in_time:
            os.kill(process, signal.SIGKILL)
            _answer_calls(listener, folder, run, (None, ""), MAX_SECONDS)
    finally:
        os.close(descriptors[0])
    run.code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    run.output = (folder / "stdout").read_bytes()
    run.said = (folder / "stderr").read_text(errors="replace")
    if not is_in_time and kill_after is None:
        run.code, run.said = -signal.SIGKILL, f"it hangs; it said: {run.said}"
    return run


def _answer_calls(
    listener: Listener, folder: Path, run: Run, plan: tuple[Point | None, str], seconds: float
) -> bool:
    """Answer all calls until the run and its children are gone; False if that is too late."""
    counts: Counter[tuple[str, str]] = Counter()
    poll = select.poll()
    poll.register(listener.descriptor, select.POLLIN)
    spent, last = 0.0, time.monotonic()
    while spent < seconds:
        events = poll.poll(1000 * min(MAX_STEP, seconds - spent))
        now = time.monotonic()
        spent, last = spent + min(MAX_STEP, now - last), now
        if not events:
            continue
        if not events[0][1] & select.POLLIN:
            return True
        call = listener.receive()
        if call is None:
            continue
        place = _name_place(call, folder)
        path = place or call.path
        counts[call.name, path] += 1
        made = Point(call.name, path, counts[call.name, path])
        (run.points if place else run.foreign).append(made)
        point, fault = plan
        is_it = made == point
        run.is_hit = run.is_hit or is_it
        if fault == FULL:
            takes_room = call.name in WRITES | SIZES and place not in (None, "stdout", "stderr")
            listener.answer(call, "ENOSPC" if run.is_hit and takes_room else "")
        elif is_it and fault == KILL:
            os.kill(call.thread, signal.SIGKILL)
        else:
            listener.answer(call, fault if is_it else "")
    return False


def _name_place(call: StoppedCall, folder: Path) -> str | None:
    """Return the name of the run's own file that a call is about, without what is random.

    That of a folder ends with a slash.
    """
    root = f"{folder}/"
    if not call.path.startswith(root):
        return None
    end = "/" if call.name in OPENS and Path(call.path).is_dir() else ""
    name = call.path.removeprefix(root).removesuffix(" (deleted)")
    return _RANDOM.sub("RANDOM", name) + end


def _enter(folder: Path, listener: socket.socket, become: Callable[[], NoReturn]) -> NoReturn:
    """Be the run: its folders, streams and variables, and calls that stop."""
    try:
        os.setsid()
        os.chdir(folder / "work")
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
        for number, name in ((1, folder / "stdout"), (2, folder / "stderr")):
            opened = os.open(name, flags)
            os.dup2(opened, number)
            os.close(opened)
        sys.stdout = open(1, "w", closefd=False, encoding="utf-8")  # noqa: SIM115
        sys.stderr = open(2, "w", 1, closefd=False, encoding="utf-8")  # noqa: SIM115
        os.environ.update(make_environment(folder))
        # The processes of a batch are forked from here; a new interpreter takes a second.
        processes._choose_context = lambda modules: multiprocessing.get_context("fork")
        tempfile.tempdir = None
        descriptor = install_filter()
        socket.send_fds(listener, [b"l"], [descriptor])
        os.close(descriptor)
        listener.close()
        become()
    except BaseException:
        traceback.print_exc()
        os._exit(99)


def _call_main(main: str) -> int:
    """Call a function as the script of a console does; return its exit code."""
    module, _, name = main.partition(":")
    try:
        getattr(import_module(module), name)()
    except SystemExit as error:
        if error.code is None or isinstance(error.code, int):
            return error.code or 0
        print(error.code, file=sys.stderr)
        return 1
    except BaseException:
        traceback.print_exc()
        return 1
    return 0


def _leave(code: int) -> NoReturn:
    """End as the interpreter does."""
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError as error:
            code = 120
            if stream is sys.stdout:
                os.write(2, f"Exception ignored in stdout: {error}\n".encode())
    os._exit(code)
