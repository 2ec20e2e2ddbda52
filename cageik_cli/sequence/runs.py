"""Frames that lie interleaved in a file, read many at a time."""

from collections import deque
from collections.abc import Callable
from threading import Lock

import numpy as np

LARGEST_RUN = 1 << 25
"""Bytes of a run, unless a frame alone has more; two runs are kept."""


class Runs:
    """Frames read in runs, for any thread.

    The last two are kept, for threads that read ahead ask for both sides of a border.

    Parameters
    ----------
    read : callable
        Takes the first frame and the one after the last, gives them as (k, m, 3).
    count : int
        Frames there are.
    size : int
        Frames to a run.
    """

    def __init__(self, read: Callable[[int, int], np.ndarray], count: int, size: int) -> None:
        self._read, self._count, self._size = read, count, size
        self._kept: deque[tuple[int, np.ndarray]] = deque(maxlen=2)
        self._lock = Lock()

    def frame(self, index: int) -> np.ndarray:
        """One frame, (m, 3)."""
        start = index - index % self._size
        with self._lock:
            run = next((run for first, run in self._kept if first == start), None)
            if run is None:
                run = self._read(start, min(start + self._size, self._count))
                self._kept.append((start, run))
        return np.asarray(run[index - start])


def run_size(layer: int, frame_bytes: int) -> int:
    """Frames to a run, where `layer` of them lie together and as many as fit are read at once."""
    return max(1, min(layer, LARGEST_RUN // frame_bytes))
