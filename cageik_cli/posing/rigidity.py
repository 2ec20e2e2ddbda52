"""As-rigid-as-possible rotations of the cells of a cage (Sorkine and Alexa 2007).

A uniform Laplacian resists rotation, because it compares δ of the moved cage with δ of the cage at
rest. Here every cage vertex has a cell, the edges e_ij = c_i − c_j to its neighbours; the cell gets
the rotation that fits its motion to e' best, and δ turns with the cells (their eqs. 6 and 8, with
uniform weights, means instead of sums):

    R_i = argmax_R tr(Rᵀ S_i),  S_i = mean_j e'_ij e_ijᵀ,        b_i = mean_j ½ (R_i + R_j) e_ij.

b replaces δ in the next solve, which uses the same factor. S is linear in the moved cage,
and b in the rotations. With Δ_x = diag(L c_x) and E_x = (L_ij (c_i − c_j)_x)_ij, for each of the
three coordinates x of the cage at rest,

    column x of all S = (Δ_x + E_x) c',        b = Σ_x ½ (Δ_x − E_x) column x of all R,

which are two sparse products per round, with three times the non-zeros of L.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from cageik_cli.geometry.rotations import nearest_rotations_by_entry
from cageik_cli.util.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """The cells of one cage at rest.

    Attributes
    ----------
    differences : (n, 3) float64
        δ = L c.
    rest_covariance : (3n, 3) float64
        S of the cage at rest, stacked by column; S is symmetric there.
    covariance_map : sparse (3n, n)
        Δ_x + E_x for x, y and z, stacked vertically.
    rotation_map : sparse (n, 3n)
        ½ (Δ_x − E_x) for x, y and z, stacked horizontally.
    """

    differences: Floats
    rest_covariance: Floats
    covariance_map: Any
    rotation_map: Any

    def fit_rotations(self, displacements: Floats) -> Floats:
        """Return the rotation R of every cell, (3, 3, n), for displacements (n, 3)."""
        columns = self.rest_covariance + self.covariance_map @ displacements
        entries = np.ascontiguousarray(columns.T).reshape(9, -1)
        return nearest_rotations_by_entry(entries).reshape(3, 3, -1)

    def rotate_differences(self, rotations: Floats) -> Floats:
        """Return the change of δ by rotations (3, 3, n): b − L c of every cell, (n, 3)."""
        return np.asarray(self.rotation_map @ rotations.reshape(3, -1).T - self.differences)


class Neighbours:
    """The neighbours of every cage vertex, which are the same in all poses of the cage.

    Parameters
    ----------
    laplacian : (n, n) float64
        The uniform Laplacian L.
    """

    def __init__(self, laplacian: Floats) -> None:
        self._rows, self._columns = np.nonzero(laplacian)  # i and j, by i
        self._entries = laplacian[self._rows, self._columns]
        self._transposed = laplacian[self._columns, self._rows]
        self._diagonal = np.flatnonzero(self._rows == self._columns)
        self._firsts = np.searchsorted(self._rows, np.arange(len(laplacian)))
        # L and its transpose have the same sparsity pattern: three copies of the rows of L are the
        # rows of `covariance_map`, and the columns of `rotation_map`.
        self._places = np.tile(self._columns, 3)
        starts = np.add.outer(np.arange(3) * len(self._rows), self._firsts)
        self._starts = np.append(starts, len(self._places))

    def build_cells(self, cage: Floats) -> Cells:
        """Return the cells of a cage with vertices (n, 3)."""
        edges = (cage[self._rows] - cage[self._columns]).T
        rows, columns = self._entries * edges, self._transposed * edges / 2
        # L c from the same edges: a cage that moves as one then changes S by rounding only.
        differences = -np.add.reduceat(rows, self._firsts, axis=1)
        rows[:, self._diagonal], columns[:, self._diagonal] = differences, differences / 2
        shape = (3 * len(cage), len(cage))
        covariance_map = sparse.csr_array((rows.ravel(), self._places, self._starts), shape)
        rotation_map = sparse.csc_array((columns.ravel(), self._places, self._starts), shape[::-1])
        # Relative to a vertex, so that a cage far from the origin loses no digits.
        rest_covariance = covariance_map @ (cage - cage[0])
        return Cells(
            np.ascontiguousarray(differences.T), rest_covariance, covariance_map, rotation_map
        )
