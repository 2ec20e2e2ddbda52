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

import numpy as np
from scipy import sparse

from cageik_cli.geometry.rotations import nearest_rotations_by_entry
from cageik_cli.util.arrays import Floats


class Neighbours:
    """The neighbours of every cage vertex, which are the same in all poses of the cage.

    Parameters
    ----------
    laplacian : (n, n) float64
        The uniform Laplacian L.
    """

    def __init__(self, laplacian: Floats) -> None:
        self.rows, self.columns = np.nonzero(laplacian)  # i and j, by i
        self.entries = laplacian[self.rows, self.columns]
        self.transposed = laplacian[self.columns, self.rows]
        self.diagonal = np.flatnonzero(self.rows == self.columns)
        self.firsts = np.searchsorted(self.rows, np.arange(len(laplacian)))
        # L and its transpose have the same sparsity pattern: three copies of the rows of L are the
        # rows of the map of covariances, and the columns of that of rotations.
        self.places = np.tile(self.columns, 3)
        starts = np.add.outer(np.arange(3) * len(self.rows), self.firsts)
        self.starts = np.append(starts, len(self.places))


class Cells:
    """The cells of one cage at rest, with vertices (n, 3)."""

    def __init__(self, neighbours: Neighbours, cage: Floats) -> None:
        edges = (cage[neighbours.rows] - cage[neighbours.columns]).T
        rows, columns = neighbours.entries * edges, neighbours.transposed * edges / 2
        # L c from the same edges: a cage that moves as one then changes S by rounding only.
        differences = -np.add.reduceat(rows, neighbours.firsts, axis=1)
        rows[:, neighbours.diagonal] = differences
        columns[:, neighbours.diagonal] = differences / 2
        pattern, shape = (neighbours.places, neighbours.starts), (3 * len(cage), len(cage))
        # Δ_x + E_x for x, y and z, stacked vertically; ½ (Δ_x − E_x), stacked horizontally.
        self._covariance_map = sparse.csr_array((rows.ravel(), *pattern), shape)
        self._rotation_map = sparse.csc_array((columns.ravel(), *pattern), shape[::-1])
        # S of the cage at rest, which is symmetric: relative to a vertex, so that a cage far from
        # the origin loses no digits.
        self._rest_covariance = self._covariance_map @ (cage - cage[0])
        self._differences = np.ascontiguousarray(differences.T)

    def fit_rotations(self, displacements: Floats) -> Floats:
        """Return the rotation R of every cell, (3, 3, n), for displacements (n, 3)."""
        columns = self._rest_covariance + self._covariance_map @ displacements
        entries = np.ascontiguousarray(columns.T).reshape(9, -1)
        return nearest_rotations_by_entry(entries).reshape(3, 3, -1)

    def rotate_differences(self, rotations: Floats) -> Floats:
        """Return the change of δ by rotations (3, 3, n): b − L c of every cell, (n, 3)."""
        return np.asarray(self._rotation_map @ rotations.reshape(3, -1).T - self._differences)
