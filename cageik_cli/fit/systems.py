"""The Laplacian of a surface, and sparse systems (μ ΛᵀΛ + s_i) f_i = b_i for many columns i.

Conjugate gradients solve them. All columns of a block take their steps together, each with its own
step lengths. The blocks do not depend on the number of threads, so neither does the result.
"""

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import sparse_laplacian
from cageik_cli.util.arrays import Floats

MAX_BLOCK_COLUMNS = 20
"""Columns that are solved together, at most: they all take the steps of the slowest of them."""


def count_columns(m: int) -> int:
    """Return how many columns of `m` entries are solved together: of a long surface, fewer."""
    max_entries = 1 << 21  # 16 MiB
    return max(1, min(MAX_BLOCK_COLUMNS, max_entries // m))


class SurfaceLaplacian:
    """The operator ΛᵀΛ of a surface, with Λ the uniform Laplacian of its edges, (m, m) sparse."""

    def __init__(self, mesh: TriMesh) -> None:
        from scipy import sparse

        self.forward = sparse_laplacian(mesh)
        self._backward = sparse.csr_array(self.forward.T)
        self._diagonal = np.asarray(self.forward.power(2).sum(axis=0), np.float64)  # of ΛᵀΛ

    def apply(self, columns: Floats) -> Floats:
        """Return ΛᵀΛ times columns (m, b)."""
        return np.asarray(self._backward @ (self.forward @ columns))

    def measure(self, weights: Floats) -> float:
        """Return the Frobenius norm of Λ times weights (m, n): their roughness."""
        width = count_columns(len(weights))
        starts = range(0, weights.shape[1], width)
        parts = [np.square(self.forward @ weights[:, s : s + width]).sum() for s in starts]
        return float(np.sqrt(np.sum(parts)))

    def solve(
        self,
        right: Floats,
        start: Floats | None,
        *,
        smoothness: float,
        shifts: Floats,
        tolerance: float,
        max_steps: int,
    ) -> Floats:
        """Return the solutions, (m, b), for right-hand sides (m, b), from a first guess.

        Preconditioned with the diagonal. Columns that have converged take further steps with the
        others of their block.

        Parameters
        ----------
        smoothness : float
            μ.
        shifts : (1, b) or (m, b) float64
            s_i, above 0.
        tolerance : float
            The steps end when the residual of each column, relative to its right-hand side and in
            the preconditioned norm, is at most this.
        """
        inverse = 1 / (shifts + smoothness * self._diagonal[:, None])
        if not smoothness:
            return right * inverse

        def multiply(columns: Floats) -> Floats:
            image = self.apply(columns)
            image *= smoothness
            image += shifts * columns
            return image

        found = np.zeros_like(right) if start is None else start.copy()
        residual = right.copy() if start is None else right - multiply(start)
        conditioned = residual * inverse
        search = conditioned.copy()
        size = _dot_columns(residual, conditioned)
        goal = tolerance**2 * _dot_columns(right, right * inverse)
        for _ in range(max_steps):
            if (size <= goal).all():
                break
            image = multiply(search)
            length = _divide(size, _dot_columns(search, image))
            found += length * search
            image *= length
            residual -= image
            np.multiply(residual, inverse, out=conditioned)
            before, size = size, _dot_columns(residual, conditioned)
            search *= _divide(size, before)
            search += conditioned
        return found


def _dot_columns(left: Floats, right: Floats) -> Floats:
    return np.asarray(np.einsum("jb,jb->b", left, right))


def _divide(above: Floats, below: Floats) -> Floats:
    """Return the quotients; 0 where a column has nothing left to solve."""
    return np.divide(above, below, out=np.zeros_like(above), where=below > 0)
