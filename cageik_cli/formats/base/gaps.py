"""Fill the gaps of an animation: linearly between the frames before and after."""

from collections.abc import Callable, Collection

import numpy as np

from cageik_cli.util.arrays import Floats


class GapFiller:
    """Interpolates frames that are not known; at either end it takes the nearest that is.

    Parameters
    ----------
    count : int
        Number of frames.
    gaps : collection of int
        Frames that are not known; at least one is.
    """

    def __init__(self, count: int, gaps: Collection[int]) -> None:
        self._gaps = gaps
        self._known = np.setdiff1d(np.arange(count), list(gaps))

    def fill(self, block: Floats, start: int, read: Callable[[int], Floats]) -> None:
        """Fill the gaps in a block of frames (k, n, 3) from `start` on, in place.

        `read` returns a known frame, (n, 3).
        """
        for frame in range(start, start + len(block)):
            if frame in self._gaps:
                block[frame - start] = self._interpolate(frame, read)

    def _interpolate(self, frame: int, read: Callable[[int], Floats]) -> Floats:
        known, place = self._known, int(np.searchsorted(self._known, frame))
        before, after = (int(known[np.clip(k, 0, len(known) - 1)]) for k in (place - 1, place))
        share = (frame - before) / (after - before) if after > before else 0.0
        return np.asarray((1 - share) * read(before) + share * read(after))
