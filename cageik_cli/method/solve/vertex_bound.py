"""The error of the best possible cage animation of a clip.

It is found on some vertices and all frames. Displacements of s vertices in F frames are a matrix D,
(s, 3F). Weights and cages with n points give a matrix of rank n at most; the best one leaves the
singular values of D beyond n (Eckart and Young 1936). No cage of n points has a smaller error on
these vertices. They are a sample of all, so the error over all vertices is seldom smaller, and a
few percent larger.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.util.arrays import Floats, Integers, spread_evenly

MIN_BOUND_VERTICES, MAX_BOUND_VERTICES = 512, 1024
"""Vertices on which the best possible error is found; within these limits, 8 per cage vertex."""


@dataclass(frozen=True, slots=True)
class VertexBound:
    """The smallest error that a cage animation can have, with a cage of `points` vertices.

    It is the root mean square over all frames and the `vertices` that were sampled, in percent of
    the diagonal.
    """

    rms_percent: float
    points: int
    vertices: int


def spread_vertices(numbers: Integers, points: int) -> Integers:
    """Choose vertices for a cage of `points`, spread over the given numbers; all of a few."""
    count = min(max(MIN_BOUND_VERTICES, 8 * points), MAX_BOUND_VERTICES)
    if count >= len(numbers):
        return numbers
    return np.asarray(numbers[spread_evenly(len(numbers), count)])


class VertexBoundAccumulator:
    """Accumulates the displacements of a clip, block by block, in memory that does not grow.

    Columns are kept until there are as many as vertices; then only D Dᵀ is.
    """

    def __init__(self) -> None:
        self._columns: list[NDArray[np.float32]] = []
        self._gram: Floats | None = None

    def update(self, columns: NDArray[np.float32]) -> None:
        """Add the displacements of the next frames, (s, 3k), in diagonals of the rest pose."""
        self._columns.append(columns)
        if sum(part.shape[1] for part in self._columns) > len(columns) > 0:
            self._fold()

    def finish(self, points: int, frames: int) -> VertexBound | None:
        """Return the bound for a cage of `points` vertices, from so many frames without gaps.

        None if no displacements were added.
        """
        held = self._columns[0] if self._columns else self._gram
        if held is None or not len(held) or not frames:
            return None
        if self._gram is None:
            data = np.hstack(self._columns).astype(np.float64)
            gram = data.T @ data
        else:
            self._fold()
            gram = self._gram
        left = np.linalg.eigvalsh(gram)[::-1][points:]
        mean = float(np.maximum(left, 0).sum()) / (len(held) * frames)
        return VertexBound(float(100 * np.sqrt(mean)), points, len(held))

    def _fold(self) -> None:
        """Replace the columns by their part of D Dᵀ."""
        if not self._columns:
            return
        data = np.hstack(self._columns).astype(np.float64)
        product = data @ data.T
        self._gram = product if self._gram is None else self._gram + product
        self._columns = []
