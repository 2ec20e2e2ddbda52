"""Subprocesses that make calls, and programs of others; all end with this process.

Subprocesses make one call at a time. They are those of `multiprocessing`. Pools, of the standard
library or of others, end no call that takes too long (before Python 3.14), and do not say how a
process ended.

Only the command line asks for subprocesses: `sys.executable` may be no Python in a program that
imports the package.
"""

import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from itertools import chain, repeat
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar

from cageik_cli.util.trial import trials

Result = TypeVar("Result")

MAX_WAIT_RATIO = 6
"""How long a limited process may take in all, in seconds per second of a processor that it may
take: it shares the machine, and a disk may be slow."""

_STARTED = time.monotonic()


class SubprocessError(Exception):
    """A subprocess has ended before its call; the text is how: "ends with SIGSEGV".

    Attributes
    ----------
    signal : str
        The name of the signal that ended it; "" for none.
    """

    def __init__(self, code: int) -> None:
        self.signal = ""
        if code < 0:
            names = {one.value: one.name for one in signal.Signals}  # real-time signals have none
            self.signal = names.get(-code, f"signal {-code}")
        super().__init__(f"ends with {self.signal or f'exit code {code}'}")


class Subprocess:
    """A process that calls functions of modules, one at a time.

    It has one thread in the linear algebra. It prints nothing on standard output, which is for
    data. It ends at once when this process ends, in whatever way.

    Parameters
    ----------
    is_silent : bool
        Whether it prints nothing on standard error, either.
    preload : sequence of str
        Modules that are imported once for all processes, where the system can fork one that has
        them. Those of the first process count.

    Raises
    ------
    OSError
        When it cannot be started.
    """

    def __init__(self, *, is_silent: bool = False, preload: Sequence[str] = ()) -> None:
        if not sys.executable or getattr(sys, "frozen", False):
            raise ChildProcessError("there is no Python that could be started")
        context = _choose_context(preload)
        self.connection, theirs = context.Pipe()
        words = theirs, is_silent, trials.are_wanted
        self._process = context.Process(target=_make_calls, args=words, daemon=True)
        with theirs:
            try:
                self._process.start()
            except (OSError, EOFError) as error:  # EOF: what others are forked from has died
                self.connection.close()
                raise ChildProcessError(f"no process can be started ({error})") from error

    def __enter__(self) -> "Subprocess":
        return self

    def __exit__(self, *error: object) -> None:
        self.end()

    def begin(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Begin a call; `finish` gives its result."""
        with suppress(ConnectionError):  # it has ended, which `finish` says
            self.connection.send((function, arguments))

    def finish(self, seconds: float | None = None) -> Any:
        """Wait for the result of a call, and return it, or raise the exception of the call.

        Raises
        ------
        TimeoutError
            When it takes more seconds; the process goes on, and is good for no other call.
        SubprocessError
            When the process has ended.
        """
        try:
            if not self.connection.poll(seconds):
                raise TimeoutError
            is_result, answer = self.connection.recv()
        except (EOFError, ConnectionError) as error:
            self._process.join()
            raise SubprocessError(self._process.exitcode or 0) from error
        if not is_result:
            raise answer
        return answer

    def call(
        self,
        function: Callable[..., Result],
        *arguments: Any,
        seconds: float | None = None,
    ) -> Result:
        """Make a call, as `begin` and `finish` do."""
        self.begin(function, *arguments)
        result: Result = self.finish(seconds)
        return result

    def end(self) -> None:
        """End the process at once, whatever it does."""
        self._process.kill()
        self._process.join()
        self.connection.close()


def _choose_context(preload: Sequence[str]) -> Any:
    """Choose how a process starts: afresh, or forked from one that has imported the modules."""
    if not preload or sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(preload))
    return context


def wait_for_any(processes: Iterable[Subprocess]) -> Subprocess:
    """Wait until a process has finished its call, or has ended, and return it."""
    waiting = {process.connection: process for process in processes}
    return waiting[wait(waiting)[0]]


def call_in_subprocesses(
    function: Callable[..., Result],
    calls: Sequence[tuple[Any, ...]],
    processes: int,
    note: Callable[[str], object] = str,
) -> Iterator[Result]:
    """Yield the results of a function for the arguments of each call, in their order.

    The first call is made in this process, and so are those for which there is no other, or whose
    process ends. Results are the same to the bit: every call gets a copy of its arguments, as
    arrays that are views may be summed in another order.

    Parameters
    ----------
    processes : int
        This one and others, at most.
    note : callable
        Takes a sentence on a process whose call is made here instead.
    """
    others: list[Subprocess] = []
    with ExitStack() as stack:
        try:
            for _ in calls[1:processes]:
                others.append(stack.enter_context(Subprocess(is_silent=True)))
        except OSError as error:
            note(f"{error}; there are fewer to share the work, which takes longer")
        for started, arguments in zip(others, calls[1:], strict=False):
            started.begin(function, *arguments)
        for arguments, other in zip(calls, chain([None], others, repeat(None)), strict=False):
            if other is not None:
                try:
                    result = other.finish()
                except (SubprocessError, MemoryError) as error:
                    end = "runs out of memory" if isinstance(error, MemoryError) else error
                    note(f"a process that shares the work {end}; its part is done again")
                else:
                    yield result
                    continue
            yield function(*pickle.loads(pickle.dumps(arguments)))


class ProgramError(Exception):
    """A program has failed; the text is how it ended, and its last words."""


class Program:
    """A program of others that takes data on its standard input, and is ended by `end`.

    It prints nothing; the end of what it says on standard error is kept for `ProgramError`. When
    this process is killed, its input ends.

    Parameters
    ----------
    words : sequence of str
        The path of the program, and its arguments; no shell reads them.

    Raises
    ------
    OSError
        When it cannot be started.
    """

    def __init__(self, words: Sequence[str]) -> None:
        self._said = tempfile.TemporaryFile()  # noqa: SIM115
        try:
            self._process = subprocess.Popen(
                words, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=self._said
            )
        except BaseException:
            self._said.close()
            raise

    def __enter__(self) -> "Program":
        return self

    def __exit__(self, *error: object) -> None:
        self.end()

    def feed(self, data: bytes) -> None:
        """Write to its standard input; raises `ProgramError` when it has ended."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(data)
        except OSError as error:  # a broken pipe; Windows says that its argument is invalid
            raise self._describe_end() from error

    def finish(self) -> None:
        """End its input, and wait until it is done; raises `ProgramError` when it fails."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.close()
        except OSError as error:
            raise self._describe_end() from error
        if self._process.wait() != 0:
            raise self._describe_end()

    def end(self) -> None:
        """End it at once, whatever it does."""
        self._process.kill()
        self._process.wait()
        assert self._process.stdin is not None
        with suppress(OSError):  # what it has not taken
            self._process.stdin.close()
        self._said.close()

    def _describe_end(self) -> ProgramError:
        """Return how it ended, with the last lines that it said."""
        kept = 2000  # bytes
        code = self._process.wait()
        self._said.seek(max(0, self._said.seek(0, os.SEEK_END) - kept))
        lines = self._said.read().decode(errors="replace").split("\n")
        said = "; ".join(line.strip() for line in lines if line.strip())
        how = str(SubprocessError(code))
        return ProgramError(f"{how}: {said}" if said else how)


def limit_process(memory: int, seconds: int) -> None:
    """Limit this process to so many seconds of a processor, and so many bytes of memory.

    It is ended as well after `MAX_WAIT_RATIO` times as many seconds in all, as when it waits for a
    lock. Memory beyond so many bytes is refused. Windows has no such limits.
    """
    if sys.platform == "win32":
        return
    import resource

    for kind, limit in ((resource.RLIMIT_DATA, memory), (resource.RLIMIT_CPU, seconds)):
        most = resource.getrlimit(kind)[1]
        limit = limit if most == resource.RLIM_INFINITY else min(limit, most)
        resource.setrlimit(kind, (limit, most))
    left = _STARTED + MAX_WAIT_RATIO * seconds - time.monotonic()
    signal.setitimer(signal.ITIMER_REAL, max(left, 1e-3))


def _make_calls(connection: Connection, is_silent: bool, are_tried: bool) -> None:
    """Make the calls that another process sends, in a process of their own.

    What that one tries before it calls a library, this one tries, too.
    """
    from cageik_cli.util.threads import use_one_blas_thread

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the other gets it, and ends this process
    _end_with_parent()
    multiprocessing.current_process().daemon = False  # it may start processes, which end with it
    trials.are_wanted = are_tried
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for descriptor in (1, 2) if is_silent else (1,):
        os.dup2(nowhere, descriptor)
    with suppress(EOFError):
        while True:
            function, arguments = connection.recv()  # imports the module of the function
            use_one_blas_thread()
            try:
                answer = True, function(*arguments)
            except Exception as error:
                answer = False, error
            connection.send(answer)


def _end_with_parent() -> None:
    """End this process when its parent does, which holds the other end of a pipe."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def wait_for_end() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait_for_end, daemon=True).start()
    if sys.platform == "linux":  # also while a library lets no thread run
        import fcntl

        fcntl.fcntl(parent.sentinel, fcntl.F_SETOWN, os.getpid())
        fcntl.fcntl(parent.sentinel, fcntl.F_SETSIG, signal.SIGKILL)
        flags = fcntl.fcntl(parent.sentinel, fcntl.F_GETFL)
        fcntl.fcntl(parent.sentinel, fcntl.F_SETFL, flags | os.O_ASYNC)
