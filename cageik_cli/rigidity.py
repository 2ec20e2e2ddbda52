"""Cages that turn with their motion: as-rigid-as-possible rotations (Sorkine and Alexa 2007).

A uniform Laplacian resists turning, since it compares δ of the moved cage with δ of the cage at
rest. Here the cell of every cage vertex, the edges e_ij = c_i − c_j to its neighbours, is given the
rotation that fits its motion to e' best, and δ turns with the cells (their eqs. 6 and 8, with
uniform weights, means instead of sums):

    R_i = argmax_R tr(Rᵀ S_i),  S_i = mean_j e'_ij e_ijᵀ,        b_i = mean_j ½ (R_i + R_j) e_ij.

b takes the place of δ in the next solve, which has the same factor. Means over neighbours are what
L is made of, and so are both: S by the product rule of a Laplacian,
S = (L c') cᵀ + c' (L c)ᵀ − L (c' cᵀ), and 2 b = R L c + (N R) c − N (R c) with N = I − L.
"""

import numpy as np

from cageik_cli.mesh import Floats
from cageik_cli.rotations import nearest_by_entry


class Cells:
    """The cells of the vertices of a cage at rest.

    Points are laid out coordinate by coordinate here, and matrices entry by entry, so that L is
    applied to all by one product and every other step passes over contiguous numbers.

    Parameters
    ----------
    laplacian : (n, n) float64
        L, uniform.
    cage : (n, 3) float64
    """

    def __init__(self, laplacian: Floats, cage: Floats) -> None:
        self._averaging = np.ascontiguousarray((np.eye(len(laplacian)) - laplacian).T)
        self._laplacian = np.ascontiguousarray(laplacian.T)
        self._cage = _centred(cage)
        self._differences = self._cage @ self._laplacian

    def rotations(self, displacements: Floats) -> Floats:
        """R of every cell, (3, 3, n), for displacements (n, 3)."""
        moved = _centred(displacements)
        moved += self._cage
        values = np.empty((4, *moved.shape))
        np.multiply(moved[:, None], self._cage, out=values[:3])
        values[3] = moved
        taken = _applied(self._laplacian, values)
        covariances = taken[3][:, None] * self._cage
        covariances += moved[:, None] * self._differences
        covariances -= taken[:3]
        return nearest_by_entry(covariances.reshape(9, -1)).reshape(covariances.shape)

    def turned(self, rotations: Floats) -> Floats:
        """How δ changes by rotations (3, 3, n): b − L c of every cell, (n, 3)."""
        values = np.empty((4, *rotations.shape[1:]))
        values[:3] = rotations
        values[3] = np.einsum("abn,bn->an", rotations, self._cage)
        means = _applied(self._averaging, values)
        both = np.einsum("abn,bn->an", rotations, self._differences)
        both += np.einsum("abn,bn->an", means[:3], self._cage)
        both -= means[3]
        both /= 2
        both -= self._differences
        return np.asarray(both.T)


def _applied(matrix: Floats, values: Floats) -> Floats:
    """Values (…, n) times an (n, n) matrix, in one product."""
    return np.asarray(values.reshape(-1, len(matrix)) @ matrix).reshape(values.shape)


def _centred(points: Floats) -> Floats:
    """Points (n, 3) about their mean, where no digits are lost: (3, n)."""
    columns = np.array(points.T, order="C")  # a copy, whatever the layout
    columns -= columns.sum(axis=1, keepdims=True) / columns.shape[1]
    return columns
