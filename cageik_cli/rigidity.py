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
from cageik_cli.rotations import nearest_rotations


class Cells:
    """The cells of the vertices of k cages at rest.

    Parameters
    ----------
    laplacian : (n, n) float64
        L, uniform.
    cages : (k, n, 3) float64
    """

    def __init__(self, laplacian: Floats, cages: Floats) -> None:
        self._laplacian = laplacian
        self._cages = cages - cages.mean(axis=1, keepdims=True)  # far from 0, digits are lost
        self._differences = laplacian @ self._cages

    def rotations(self, displacements: Floats) -> Floats:
        """R of every cell, (k, n, 3, 3), for displacements (k, n, 3)."""
        k, n, _ = displacements.shape
        moved = self._cages + (displacements - displacements.mean(axis=1, keepdims=True))
        products = (moved[..., :, None] * self._cages[..., None, :]).reshape(k, n, 9)
        taken = self._laplacian @ np.concatenate([products, moved], axis=2)
        covariances = (
            taken[..., 9:, None] * self._cages[..., None, :]
            + moved[..., :, None] * self._differences[..., None, :]
            - taken[..., :9].reshape(k, n, 3, 3)
        )
        return nearest_rotations(covariances.reshape(-1, 3, 3)).reshape(k, n, 3, 3)

    def turned(self, rotations: Floats) -> Floats:
        """How δ changes by rotations (k, n, 3, 3): b − L c of every cell, (k, n, 3)."""
        k, n = rotations.shape[:2]
        turned = (rotations @ self._cages[..., None])[..., 0]
        values = np.concatenate([rotations.reshape(k, n, 9), turned], axis=2)
        means = values - self._laplacian @ values
        both = rotations @ self._differences[..., None] + (
            means[..., :9].reshape(k, n, 3, 3) @ self._cages[..., None]
        )
        return np.asarray((both[..., 0] - means[..., 9:]) / 2 - self._differences)
