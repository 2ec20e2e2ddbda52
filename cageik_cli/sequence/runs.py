"""Frames read in runs: as many at a time as lie together in a file."""

from abc import ABC, abstractmethod
from collections import deque
from threading import Lock

import numpy as np

LARGEST_RUN = 1 << 25
"""Bytes of a run, unless a frame alone has more."""

KEPT = 2
"""Runs that are kept: threads that read ahead ask for both sides of a border."""


class FramesInRuns(ABC):
    """Frames read in runs, for any thread.

    Parameters
    ----------
    count, vertices : int
        Frames there are, and vertices of each.
    layer : int
        Frames that lie together: a run is as many, or what fits.
    itemsize : int
        Bytes of a coordinate.
    """

    def __init__(self, count: int, vertices: int, layer: int, itemsize: int) -> None:
        self.count, self.vertices = count, vertices
        self._size = max(1, min(layer, LARGEST_RUN // (3 * vertices * itemsize)))
        self._kept: deque[tuple[int, np.ndarray]] = deque()
        self._lock = Lock()

    @abstractmethod
    def run(self, start: int, stop: int) -> np.ndarray:
        """Read frames `start` to `stop`, that left out: (k, m, 3)."""

    def frame(self, index: int) -> np.ndarray:
        """Positions of one frame, (m, 3).

        Raises
        ------
        InputError
            When it cannot be read.
        """
        start = index - index % self._size
        with self._lock:
            run = next((run for first, run in self._kept if first == start), None)
            if run is None:
                if len(self._kept) == KEPT:
                    self._kept.popleft()  # before there is a third
                run = self.run(start, min(start + self._size, self.count))
                self._kept.append((start, run))
        return np.asarray(run[index - start])
