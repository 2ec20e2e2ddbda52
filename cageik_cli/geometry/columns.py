"""Points of frames as columns of a matrix: a row per point, its frames one after the other."""

import numpy as np

from cageik_cli.util import compiled
from cageik_cli.util.arrays import Floats


def frames_to_columns(points: Floats) -> Floats:
    """Return the points of k frames, (k, p, 3), as columns (p, 3k)."""
    k, p, _ = points.shape
    return points.transpose(1, 0, 2).reshape(p, 3 * k)


def columns_to_frames(columns: Floats) -> Floats:
    """Return columns (p, 3k) as points of k frames, (k, p, 3); a view."""
    return columns.reshape(len(columns), -1, 3).transpose(1, 0, 2)


def place_columns(columns: Floats, centres: Floats, frames: Floats, first: int = 0) -> None:
    """Fill p points of frames, (k, m, 3), from number `first` on.

    They are the columns, (p, 3k), plus the centres of the frames, (k, 3).
    """
    if compiled.kernel is not None:
        compiled.kernel.place_columns(columns, np.ascontiguousarray(centres), frames, first)
    else:
        points = frames[:, first : first + len(columns)]
        np.add(columns_to_frames(columns), centres[:, None], out=points)
