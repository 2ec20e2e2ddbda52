"""Points in an order in which neighbours are close, and distances between points."""

import numpy as np
from numpy.typing import NDArray

from cageik_cli.util.arrays import Floats, Integers

GRID_BITS = 10
"""Cells along the longest axis, as a power of two: finer than blocks of points ever are."""

_SPREADING = ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249))

MAX_COMPARED_PAIRS = 10_000_000
"""Pairs of points that are all compared: a tree takes longer to import."""

PAIRS_PER_BLOCK = 50_000
"""Pairs that are compared at once; they fit in the processor's cache."""


def order_by_place(points: Floats) -> Integers:
    """Return an order, (m,), of points, (m, 3), in which neighbours are close to each other.

    It follows the cells of a grid along a curve that visits each cube of cells before the next
    (Morton 1966).
    """
    if len(points) == 0:
        return np.empty(0, np.int64)
    low, size = points.min(axis=0), np.ptp(points, axis=0).max()
    cells = ((points - low) * ((2**GRID_BITS - 1) / size if size > 0 else 0.0)).astype(np.int32)
    x, y, z = (_spread_bits(cells[:, k]) << k for k in range(3))
    return np.argsort(x | y | z, kind="stable")


def _spread_bits(numbers: NDArray[np.int32]) -> NDArray[np.int32]:
    """Move the bits of numbers below 2**10 to every third place."""
    spread = numbers
    for shift, kept in _SPREADING:
        spread = (spread | spread << shift) & kept
    return spread


def measure_distances(places: Floats, points: Floats) -> Floats:
    """Return the distance of each of `points`, (m, 3), from the nearest of `places`, (n, 3)."""
    if len(points) * len(places) > MAX_COMPARED_PAIRS:
        from scipy.spatial import cKDTree

        return np.asarray(cKDTree(places).query(points)[0])
    squares = np.full(len(points), np.inf)
    columns = np.ascontiguousarray(places.T)
    size = max(1, PAIRS_PER_BLOCK // max(1, len(points)))
    for start in range(0, len(places), size):
        block = columns[:, start : start + size]
        offsets = (points[:, k, None] - block[k] for k in range(3))
        x, y, z = (offset * offset for offset in offsets)
        np.minimum(squares, (x + y + z).min(axis=1), out=squares)
    return np.asarray(np.sqrt(squares))
