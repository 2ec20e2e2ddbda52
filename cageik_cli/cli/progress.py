"""What a run shows while it goes on: a progress bar on a terminal, and seconds a stage."""

import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from typing import NoReturn

from tqdm import tqdm

from cageik_cli.util.outputs import prepare, write_text
from cageik_cli.util.progress import Observer
from cageik_cli.util.text import row

# What each stage's bar counts; the stages of a frame share one.
_BARS = {
    "bind": ("bind", "vertices"),
    "read": ("frames", "frames"),
    "edit": ("edit", "frames"),
    "export": ("export", "frames"),
    "batch": ("batch", "clips"),
}


class Watch(Observer):
    """Times the stages, and draws bars when asked.

    Attributes
    ----------
    seconds : dict
        Time in each stage so far, of all threads; `read` is time spent waiting for frames that
        threads read ahead.
    remarks : list of (topic, text)
        What was remarked so far.
    """

    def __init__(self, draw: bool) -> None:
        self.seconds: dict[str, float] = {}
        self.remarks: list[tuple[str, str]] = []
        self._start = time.perf_counter()
        self._lock = Lock()
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
            with self._lock:  # stages of several blocks run beside each other
                self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def advance(self, done: int, total: int) -> None:
        """Move the bar."""
        if self._bar is not None:
            self._bar.total = total
            self._bar.update(done - self._bar.n)

    def remark(self, topic: str, text: str) -> None:
        """Keep it for the end, as a line would break the bar; once, if several exports say it."""
        if (topic, text) not in self.remarks:
            self.remarks.append((topic, text))

    def close(self) -> None:
        """End the bar, and take the seconds in all as `total`."""
        if self._bar is not None:
            self._bar.close()
        self.seconds["total"] = time.perf_counter() - self._start

    def rows(self) -> list[tuple[str, str]]:
        """What was remarked, and the seconds, as labelled lines."""
        stages = ", ".join(f"{name} {value:.2f}" for name, value in self.seconds.items())
        return [*self.remarks, ("seconds", stages)]

    def _open(self, label: str, unit: str) -> None:
        if self._bar is not None:
            self._bar.close()
        self._shown = label
        self._bar = tqdm(desc=label, unit=unit, file=sys.stderr, dynamic_ncols=True)


class Lines(Watch):
    """Shows what is remarked at once, a line each, if it draws at all."""

    def __init__(self, draw: bool) -> None:
        super().__init__(draw)
        self._speaks = draw

    def remark(self, topic: str, text: str) -> None:
        """Show it."""
        if self._speaks:
            tqdm.write(row((topic, text)), file=sys.stderr)


@contextmanager
def watched(
    draw: bool, timings: Path | None, overwrite: bool, kind: type[Watch] = Watch
) -> Iterator[Watch]:
    """A watch over the block, closed at its end; its seconds are written if the block succeeds."""
    if timings is not None:
        prepare(timings, overwrite)
    watch = kind(draw)
    try:
        yield watch
    finally:
        watch.close()
    if timings is not None:
        write_text(timings, json.dumps(watch.seconds, indent=1) + "\n", overwrite)
