"""Integers of vertices as differences from their neighbours, which pack better.

Weights and errors are smooth over a surface: the numbers of a vertex are near the mean of those of
its neighbours that come before it. Where they are all on one side this mean lacks about as much as
the neighbours' own did, so that half of that is added. What is left is small, and its sign is
stored in the lowest bit, so that the higher bytes are nearly always zero.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from cageik_cli.util.arrays import Integers


class Predictor:
    """Predicts the numbers of a vertex from the vertices before it.

    That is the mean over the corners of its faces that come before it, rounded down, or else the
    number of the vertex before it; 0 for the first.

    Parameters
    ----------
    faces : (t, 3) int
    count : int
        The number m of vertices.
    """

    def __init__(self, faces: Integers, count: int) -> None:
        corners = np.concatenate([np.roll(faces, turn, axis=1).ravel() for turn in (1, 2)])
        own = np.concatenate([faces.ravel()] * 2)
        is_before = corners < own
        entries = (np.ones(is_before.sum(), np.int64), (own[is_before], corners[is_before]))
        self._before = csr_array(entries, shape=(count, count))
        self._counts = np.asarray(self._before.sum(axis=1)).reshape(-1)

    def encode(self, values: NDArray[np.int16]) -> NDArray[np.int16]:
        """Return what the prediction lacks, of the same shape; the last axis is that of vertices.

        A difference d is stored as 2 d, or -2 d - 1 if it is negative, in 16 bits without a sign.
        Larger numbers begin again, as sums of 16 bits do.
        """
        encoded = np.empty_like(values)
        for place in np.ndindex(values.shape[:-1]):
            row = values[place]
            lack = row - self._average(row)
            left = lack - (self._average(lack) >> 1)
            encoded[place] = (left << 1) ^ (left >> 15)
        return encoded

    def _average(self, row: NDArray[np.int16]) -> NDArray[np.int16]:
        """Return the mean of the vertices before each one, (m,)."""
        means = (self._before @ row.astype(np.int64)) // np.maximum(self._counts, 1)
        before = np.concatenate([[0], row[:-1]])
        return np.where(self._counts > 0, means, before).astype(np.int16)
