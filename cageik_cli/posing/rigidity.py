"""Cages that turn with their motion: as-rigid-as-possible rotations (Sorkine and Alexa 2007).

A uniform Laplacian resists turning, since it compares δ of the moved cage with δ of the cage at
rest. Here the cell of every cage vertex, the edges e_ij = c_i − c_j to its neighbours, is given the
rotation that fits its motion to e' best, and δ turns with the cells (their eqs. 6 and 8, with
uniform weights, means instead of sums):

    R_i = argmax_R tr(Rᵀ S_i),  S_i = mean_j e'_ij e_ijᵀ,        b_i = mean_j ½ (R_i + R_j) e_ij.

b takes the place of δ in the next solve, which has the same factor. S is linear in the moved cage,
and b in the rotations. With Δ_x = diag(L c_x) and E_x = (L_ij (c_i − c_j)_x)_ij, for each of the
three coordinates x of the cage at rest,

    column x of all S = (Δ_x + E_x) c',        b = Σ_x ½ (Δ_x − E_x) column x of all R,

which are two sparse products a round, with as many numbers as L has.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from cageik_cli.geometry.rotations import nearest_rotations_by_entry
from cageik_cli.util.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """The cells of the vertices of one cage at rest.

    Attributes
    ----------
    differences : (n, 3) float64
        δ = L c.
    rest_covariance : (3n, 3) float64
        S of the cage at rest: its columns, which are its rows too, one below the other.
    covariance_map : sparse (3n, n)
        Δ_x + E_x, one below the other.
    rotation_map : sparse (n, 3n)
        ½ (Δ_x − E_x), beside each other.
    """

    differences: Floats
    rest_covariance: Floats
    covariance_map: Any
    rotation_map: Any

    def fit_rotations(self, displacements: Floats) -> Floats:
        """R of every cell, (3, 3, n), for displacements (n, 3)."""
        columns = self.rest_covariance + self.covariance_map @ displacements
        entries = np.ascontiguousarray(columns.T).reshape(9, -1)
        return nearest_rotations_by_entry(entries).reshape(3, 3, -1)

    def rotate_differences(self, rotations: Floats) -> Floats:
        """How δ changes by rotations (3, 3, n): b − L c of every cell, (n, 3)."""
        return np.asarray(self.rotation_map @ rotations.reshape(3, -1).T - self.differences)


class Neighbours:
    """Which vertices of a cage are neighbours: all that its cells have in common, however it lies.

    Parameters
    ----------
    laplacian : (n, n) float64
        L, uniform.
    """

    def __init__(self, laplacian: Floats) -> None:
        self._rows, self._columns = np.nonzero(laplacian)  # i and j, by i
        self._entries = laplacian[self._rows, self._columns]
        self._transposed = laplacian[self._columns, self._rows]
        self._diagonal = np.flatnonzero(self._rows == self._columns)
        self._firsts = np.searchsorted(self._rows, np.arange(len(laplacian)))
        # L has its entries at the same places as its transpose: its rows, three times, are those of
        # one of the two matrices of cells, and the columns of the other.
        self._places = np.tile(self._columns, 3)
        starts = np.add.outer(np.arange(3) * len(self._rows), self._firsts)
        self._starts = np.append(starts, len(self._places))

    def build_cells(self, cage: Floats) -> Cells:
        """The cells of the cage at (n, 3)."""
        edges = (cage[self._rows] - cage[self._columns]).T
        rows, columns = self._entries * edges, self._transposed * edges / 2
        # L c by these edges: a cage that moves as one then changes S by nothing but rounding.
        differences = -np.add.reduceat(rows, self._firsts, axis=1)
        rows[:, self._diagonal], columns[:, self._diagonal] = differences, differences / 2
        shape = (3 * len(cage), len(cage))
        covariance = sparse.csr_array((rows.ravel(), self._places, self._starts), shape)
        turning = sparse.csc_array((columns.ravel(), self._places, self._starts), shape[::-1])
        # Measured from a vertex, a cage far from the origin loses no digits.
        at_rest = covariance @ (cage - cage[0])
        return Cells(np.ascontiguousarray(differences.T), at_rest, covariance, turning)
