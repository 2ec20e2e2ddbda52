"""What a run shows while it goes on: a progress bar on a terminal, and seconds a stage."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

from tqdm import tqdm

from cageik_cli.extraction import Observer

# What each stage's bar counts; the stages of a frame share one.
_BARS = {"bind": ("bind", "vertices"), "read": ("frames", "frames")}


class Watch(Observer):
    """Times the stages, and draws bars when asked.

    Attributes
    ----------
    seconds : dict
        Time in each stage so far; `read` is time spent waiting for frames that threads read ahead.
    """

    def __init__(self, draw: bool) -> None:
        self.seconds: dict[str, float] = {}
        self._start = time.perf_counter()
        self._bar: tqdm[NoReturn] | None = None
        self._shown = ""
        self._draw = draw and sys.stderr is not None and sys.stderr.isatty()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage; a stage with a bar of its own opens it."""
        if self._draw and name in _BARS and _BARS[name][0] != self._shown:
            self._open(*_BARS[name])
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def advance(self, done: int, total: int) -> None:
        """Move the bar."""
        if self._bar is not None:
            self._bar.total = total
            self._bar.update(done - self._bar.n)

    def close(self) -> dict[str, float]:
        """End the bar; the seconds of the stages and in all."""
        if self._bar is not None:
            self._bar.close()
        return self.seconds | {"total": time.perf_counter() - self._start}

    def _open(self, label: str, unit: str) -> None:
        if self._bar is not None:
            self._bar.close()
        self._shown = label
        self._bar = tqdm(desc=label, unit=f" {unit}", file=sys.stderr, dynamic_ncols=True)
