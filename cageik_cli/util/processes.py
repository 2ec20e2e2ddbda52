"""Calls of one function in subprocesses, where threads would not help.

What is pickled goes from this process to its own child and back, through no named file. Only the
command line asks for processes: `sys.executable` may be no Python in a program that imports the
package.
"""

import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from importlib import import_module
from tempfile import TemporaryFile
from typing import Any, TypeVar

Result = TypeVar("Result")


_Child = subprocess.Popen[bytes]


_PROGRAM = (
    "import sys; sys.path[:] = {}; from cageik_cli.util import processes; processes.run_in_child()"
)


def call_in_subprocesses(
    function: Callable[..., Result], calls: Sequence[tuple[Any, ...]], processes: int
) -> Iterator[Result]:
    """Yield the results of a function for the arguments of each call, in their order.

    The first call is made in this process, and so are those for which there is no other, or whose
    process fails. Results are the same to the bit: every call gets a copy of its arguments, as
    arrays that are views may be summed in another order.

    Parameters
    ----------
    function : callable
        Of a module; a process finds it by name.
    processes : int
        This one and others, at most.
    """
    packed = [pickle.dumps(arguments) for arguments in calls]
    with ExitStack() as stack:
        others: list[_Child | None] = []
        for data in packed[1:processes]:
            others.append(_start(function, data))
            stack.callback(_end, others[-1])
        for data, other in zip(packed, [None, *others, *[None] * len(packed)], strict=False):
            found = None if other is None else _wait_for_result(other)
            yield function(*pickle.loads(data)) if found is None else found[0]


def _start(function: Callable[..., Any], data: bytes) -> _Child | None:
    """Start a process that makes a call; None if that is not possible."""
    if not sys.executable or getattr(sys, "frozen", False):
        return None
    words = [sys.executable, "-I", "-c", _PROGRAM.format(sys.path)]
    with suppress(OSError), TemporaryFile() as given:  # no room, no memory, no such program
        pickle.dump((function.__module__, function.__name__), given)
        given.write(data)
        given.seek(0)
        out, silent = subprocess.PIPE, subprocess.DEVNULL
        return subprocess.Popen(words, stdin=given, stdout=out, stderr=silent)
    return None


def _wait_for_result(process: _Child) -> tuple[Any] | None:
    """Return the result of a process in a tuple, or None if it failed."""
    written, _ = process.communicate()
    return None if process.returncode else (pickle.loads(written),)


def _end(process: _Child | None) -> None:
    """End a process, at once if it still works."""
    if process is not None:
        with process:
            process.kill()


def run_in_child() -> None:
    """Make the call that standard input holds, and write its result to standard output."""
    from cageik_cli.util.threads import use_one_blas_thread  # slow to import

    module, name = pickle.load(sys.stdin.buffer)
    arguments = pickle.load(sys.stdin.buffer)
    with os.fdopen(os.dup(1), "wb") as result:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # libraries print there
        use_one_blas_thread()
        pickle.dump(getattr(import_module(module), name)(*arguments), result)
