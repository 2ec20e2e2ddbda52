"""Calls tried in another process first: a library may end the process on a damaged file.

Only the command line tries: what imports the package may not be ready for further processes. This
module is imported by every start, so it imports little.
"""

import os
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager, suppress
from threading import Lock
from typing import Any

MIN_TRIAL_BYTES = 768 << 20
"""Memory that a trial may take besides a multiple of its files; a quarter of it are libraries."""

MAX_TRIAL_RATIO = 16
"""Memory that a trial may take, besides, in bytes of its files."""

MIN_TRIAL_SECONDS = 10
"""Seconds of a processor that a trial may take, and one more for each MiB of its files."""

TOO_LONG = ("SIGXCPU", "SIGALRM")
"""How a process ends that takes more of a processor than it may, or waits longer."""


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
        self._passed: set[Hashable] = set()
        self._lock, self._silences = Lock(), 0
        self._kept: int | None = None

    def find_fault(
        self, library: str, call: Callable[..., str | None], *arguments: Hashable, key: str
    ) -> str:
        """Call a function of a module in another process; return what is wrong, if that is known.

        It is what the call returns, or how the process ended, which is put down to a library.
        Exceptions of the call are left to the caller, who does the same again. A call that has
        passed is not tried again, unless the `key` of what it reads has changed.
        """
        tried = (call, arguments, key)
        if not self.are_wanted or tried in self._passed:
            return ""
        from cageik_cli.util.processes import Subprocess, SubprocessError

        end: object = ""
        try:
            with Subprocess(is_silent=True) as process:
                fault = process.call(_try_call, call, arguments)
                if fault:
                    return fault
        except OSError:
            return ""  # the call itself may still work
        except MemoryError:
            end = "takes too much memory"
        except SubprocessError as error:
            if error.signal:
                end = "takes too long" if error.signal in TOO_LONG else error
        if end:
            return f"is damaged: {library} {end} on it; export it again"
        self._passed.add(tried)
        return ""

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
        if self.allowed_bytes is None:
            return
        from cageik_cli.util.processes import limit_process

        self.allowed_bytes += size
        memory = MIN_TRIAL_BYTES + MAX_TRIAL_RATIO * self.allowed_bytes
        limit_process(memory, MIN_TRIAL_SECONDS + (self.allowed_bytes >> 20))


trials = Trials()


def _try_call(call: Callable[..., str | None], arguments: tuple[Any, ...]) -> str:
    """Make a call within limits; return the fault that it finds, if it is not out of memory."""
    # USD would write the report of a crash where temporary files are: nothing can be there.
    os.environ.update(TMPDIR=os.devnull, PXR_WORK_THREAD_LIMIT="1")
    trials.are_wanted, trials.allowed_bytes = False, 0
    trials.allow(0)
    try:
        return call(*arguments) or ""
    except MemoryError:
        raise
    except Exception as error:  # the caller meets it again, and says what is wrong
        if "bad_alloc" in str(error):
            raise MemoryError from error
        return ""
