"""Calls tried in another process first: a library may end the process on a damaged file.

Only the command line tries: what imports the package may not be ready for further processes. This
module is imported by every start, so it imports little.
"""

import json
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from threading import Lock

MIN_TRIAL_BYTES = 768 << 20
"""Memory that a trial may take besides a multiple of its files; a quarter of it are libraries."""

MAX_TRIAL_RATIO = 16
"""Memory that a trial may take, besides, in bytes of its files."""

MIN_TRIAL_SECONDS = 10
"""Seconds of a processor that a trial may take, and one more for each MiB of its files."""

OUT_OF_MEMORY, FOUND_FAULT = 77, 78
"""Exit codes of a trial that had too little memory, and of one whose call returned a fault."""

_TRIAL_PROGRAM = (
    "import sys; sys.path[:] = {}; from cageik_cli.util import trial; trial.run_in_child()"
)


class Trials:
    """Whether calls are tried, and what is allowed to the one that this process tries.

    Attributes
    ----------
    are_wanted : bool
        Whether this process tries calls in another one.
    allowed_bytes : int, optional
        Bytes of the files of the call that this process was started to try; None in others.
    """

    def __init__(self) -> None:
        self.are_wanted = False
        self.allowed_bytes: int | None = None
        self._passed: set[tuple[str, str]] = set()
        self._lock, self._silences = Lock(), 0
        self._kept: int | None = None

    def find_fault(
        self, library: str, call: Callable[..., str | None], *arguments: object, key: str
    ) -> str:
        """Call a function of a module in another process; return what is wrong, if that is known.

        It is what the call returns, or how the process ended, which is put down to a library.
        Arguments are such that JSON holds them. Exceptions of the call are left to the caller, who
        does the same again. A call that has passed is not tried again, unless the `key` of what it
        reads has changed.
        """
        words = json.dumps([call.__module__, call.__name__, *arguments])
        if not self.are_wanted or (words, key) in self._passed or not sys.executable:
            return ""
        try:
            code, text = _run_child(words)
        except OSError:
            return ""  # the call itself may still work
        if code == FOUND_FAULT:
            return str(json.loads(text.splitlines()[-1]))
        end = _describe_end(code)
        if not end:
            self._passed.add((words, key))
        return f"is damaged: {library} {end} on it; export it again" if end else ""

    @contextmanager
    def silence(self) -> Iterator[None]:
        """Let a library print nothing on the standard error of a process that tries calls.

        It does on some damaged files, before the call raises what is wrong.
        """
        if not self.are_wanted:
            yield
            return
        self._change_silence(1)
        try:
            yield
        finally:
            self._change_silence(-1)

    def _change_silence(self, step: int) -> None:
        """Count one more, or one less, that wants silence: the last gives standard error back."""
        with self._lock:
            self._silences += step
            if step > 0 and self._silences == 1:
                with suppress(OSError):  # it is closed
                    self._kept = os.dup(2)
                    nowhere = os.open(os.devnull, os.O_WRONLY)
                    os.dup2(nowhere, 2)
                    os.close(nowhere)
            elif self._silences == 0 and self._kept is not None:
                os.dup2(self._kept, 2)
                os.close(self._kept)
                self._kept = None

    def allow(self, size: int) -> None:
        """Allow the call that is tried here to take memory and time for as many more bytes."""
        if self.allowed_bytes is None or sys.platform == "win32":
            return
        import resource

        self.allowed_bytes += size
        memory = MIN_TRIAL_BYTES + MAX_TRIAL_RATIO * self.allowed_bytes
        seconds = MIN_TRIAL_SECONDS + (self.allowed_bytes >> 20)
        for kind, limit in ((resource.RLIMIT_DATA, memory), (resource.RLIMIT_CPU, seconds)):
            most = resource.getrlimit(kind)[1]
            limit = limit if most == resource.RLIM_INFINITY else min(limit, most)
            resource.setrlimit(kind, (limit, most))


def _run_child(words: str) -> tuple[int, bytes]:
    """Run a process that makes a call; return its exit code and what it prints."""
    import subprocess
    from tempfile import TemporaryDirectory

    # USD writes a report of a crash where temporary files are.
    with TemporaryDirectory() as folder:
        environment = {"TMPDIR": folder, "PXR_WORK_THREAD_LIMIT": "1"}
        done = subprocess.run(
            [sys.executable, "-I", "-c", _TRIAL_PROGRAM.format(sys.path), words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=os.environ | environment,
            check=False,
        )
    return done.returncode, done.stdout


def _describe_end(code: int) -> str:
    """Return what an exit code says of a trial; nothing if it says nothing."""
    if code == OUT_OF_MEMORY:
        return "takes too much memory"
    if code >= 0:
        return ""
    name = signal.Signals(-code).name
    return "takes too long" if name == "SIGXCPU" else f"ends with {name}"


trials = Trials()


def run_in_child() -> None:
    """Make the call that the arguments of this process name, within limits."""
    module, name, *arguments = json.loads(sys.argv[1])
    trials.allowed_bytes = 0
    trials.allow(0)
    try:
        fault = getattr(import_module(module), name)(*arguments)
    except MemoryError:
        sys.exit(OUT_OF_MEMORY)
    except Exception as error:  # the caller meets it again, and says what is wrong
        if "bad_alloc" in str(error):
            sys.exit(OUT_OF_MEMORY)
        return
    if fault:
        print("", json.dumps(fault), sep="\n", flush=True)
        sys.exit(FOUND_FAULT)
