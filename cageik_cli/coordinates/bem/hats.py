"""The hats of a cage at the vertices of its panels."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cageik_cli.util.arrays import Floats, Integers

if TYPE_CHECKING:
    from scipy import sparse

CORNERS = 3
"""A vertex of a panel is in a face of the cage: no more hats than this are above 0 there."""


@dataclass(frozen=True, slots=True, eq=False)
class Hats:
    """Values of the hats of n cage vertices at v points of the cage's surface.

    Attributes
    ----------
    corners : (v, 3) int64
        Vertices of a face of the cage that the point is in, in any order.
    values : (v, 3) float64
        Their hats at the point, which sum to 1; the others are 0.
    count : int
        n.
    """

    corners: Integers
    values: Floats
    count: int

    @staticmethod
    def at_vertices(count: int) -> "Hats":
        """Return the hats at the vertices of the cage."""
        values = np.zeros((count, CORNERS))
        values[:, 0] = 1
        return Hats(np.repeat(np.arange(count)[:, None], CORNERS, axis=1), values, count)

    def add_middles(self, ends: Integers) -> "Hats":
        """Return the hats at all points, and then in the middle of each pair of `ends`, (e, 2)."""
        corners = self.corners[ends].reshape(len(ends), 2 * CORNERS)
        values = self.values[ends].reshape(corners.shape) / 2
        order = np.argsort(corners, axis=1, kind="stable")
        corners = np.take_along_axis(corners, order, axis=1)
        values = np.take_along_axis(values, order, axis=1)
        # Each hat takes the values of those before it of the same corner, and leaves them nothing.
        for k in range(1, 2 * CORNERS):
            is_same = corners[:, k] == corners[:, k - 1]
            values[:, k] += np.where(is_same, values[:, k - 1], 0)
            values[:, k - 1] = np.where(is_same, 0, values[:, k - 1])
        kept = np.sort(np.argsort(values == 0, axis=1, kind="stable")[:, :CORNERS], axis=1)
        return Hats(
            np.concatenate([self.corners, np.take_along_axis(corners, kept, axis=1)]),
            np.concatenate([self.values, np.take_along_axis(values, kept, axis=1)]),
            self.count,
        )

    def evaluate(self, corners: Integers, barycentric: Floats) -> Floats:
        """Return the hats, (..., n), between three of the points.

        Parameters
        ----------
        corners : (..., 3) int64
            Numbers of points.
        barycentric : (..., 3) float64
        """
        hats = np.zeros((*barycentric.shape[:-1], self.count))
        places = tuple(np.indices(hats.shape[:-1])[..., None])
        for k in range(3):
            values = barycentric[..., k, None] * self.values[corners[..., k]]
            # A point's corners may be equal where their values are 0.
            np.add.at(hats, (*places, self.corners[corners[..., k]]), values)
        return hats

    def to_matrix(self) -> "sparse.csr_array":
        """Return the values as a sparse matrix, (v, n)."""
        from scipy import sparse

        rows = np.repeat(np.arange(len(self.corners)), CORNERS)
        used = self.values.ravel() != 0
        entries = (self.values.ravel()[used], (rows[used], self.corners.ravel()[used]))
        return sparse.csr_array(entries, shape=(len(self.corners), self.count))
