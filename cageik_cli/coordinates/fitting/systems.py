"""Sparse systems (μ ΛᵀΛ + g_i Ω + λ) f_i = b_i for many columns i, by conjugate gradients.

All columns of a block take their steps together, each with its own step lengths. The blocks do not
depend on the number of threads, so neither does the result.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import sparse_laplacian
from cageik_cli.util.arrays import Floats

if TYPE_CHECKING:
    from scipy import sparse

MAX_BLOCK_COLUMNS = 20
MAX_BLOCK_ENTRIES = 1 << 21
"""Largest number of columns, and of their entries, that are solved together."""


def count_columns(m: int) -> int:
    """Return how many columns of `m` entries are solved together."""
    return max(1, min(MAX_BLOCK_COLUMNS, MAX_BLOCK_ENTRIES // m))


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceLaplacian:
    """The operator ΛᵀΛ of a surface, with Λ its uniform Laplacian.

    Attributes
    ----------
    forward, backward : (m, m) csr_array
        Λ and Λᵀ.
    diagonal : (m,) float64
        The diagonal of ΛᵀΛ.
    """

    forward: "sparse.csr_array"
    backward: "sparse.csr_array"
    diagonal: Floats

    @staticmethod
    def from_mesh(mesh: TriMesh) -> "SurfaceLaplacian":
        """Build the operator of the edges of `mesh`."""
        from scipy import sparse

        forward = sparse_laplacian(mesh)
        squares = np.asarray(forward.power(2).sum(axis=0), np.float64)
        return SurfaceLaplacian(forward, sparse.csr_array(forward.T), squares)

    def apply(self, columns: Floats) -> Floats:
        """Return ΛᵀΛ times columns (m, b)."""
        return np.asarray(self.backward @ (self.forward @ columns))

    def measure(self, weights: Floats) -> float:
        """Return the Frobenius norm of Λ times weights (m, n): their roughness."""
        width = count_columns(len(weights))
        starts = range(0, weights.shape[1], width)
        parts = [np.square(self.forward @ weights[:, s : s + width]).sum() for s in starts]
        return float(np.sqrt(np.sum(parts)))


@dataclass(frozen=True, slots=True)
class Precision:
    """When conjugate gradients stop, and what they leave out.

    Attributes
    ----------
    tolerance : float
        Residual of each column relative to its right-hand side, in the preconditioned norm.
    max_steps : int
        Few suffice between two cage solves, as each begins where the last has ended.
    negligible : float
        Columns that can change the motion of the vertices by less than this share of it, as root
        mean squares, are not solved.
    """

    tolerance: float = 1e-3
    max_steps: int = 5
    negligible: float = 1e-3


EXACT = Precision(1e-14, 10_000, 0.0)
"""To rounding, for tests and small problems."""


@dataclass(frozen=True, slots=True, eq=False)
class ShiftedSystem:
    """The matrices μ ΛᵀΛ + g_i Ω + λ of a block of columns.

    Attributes
    ----------
    smoothness, ridge : float
        μ and λ.
    row_weights : (m, 1) float64 or None
        The diagonal of Ω; ones if None.
    shifts : (b,) float64
        g_i, not negative.
    """

    surface: SurfaceLaplacian
    smoothness: float
    ridge: float
    row_weights: Floats | None
    shifts: Floats

    def solve(self, right: Floats, start: Floats | None, precision: Precision) -> Floats:
        """Return the solutions, (m, b), for right-hand sides (m, b), from a first guess.

        Preconditioned with the diagonal. Columns that have converged take further steps with the
        others of their block.
        """
        inverse = 1 / (self._shift_diagonal() + self.smoothness * self.surface.diagonal[:, None])
        if not self.smoothness:
            return right * inverse
        found = np.zeros_like(right) if start is None else start.copy()
        residual = right.copy() if start is None else right - self._apply(start)
        conditioned = residual * inverse
        search = conditioned.copy()
        size = _dot_columns(residual, conditioned)
        goal = precision.tolerance**2 * _dot_columns(right, right * inverse)
        for _ in range(precision.max_steps):
            if (size <= goal).all():
                break
            image = self._apply(search)
            length = _divide(size, _dot_columns(search, image))
            found += length * search
            image *= length
            residual -= image
            np.multiply(residual, inverse, out=conditioned)
            before, size = size, _dot_columns(residual, conditioned)
            search *= _divide(size, before)
            search += conditioned
        return found

    def _apply(self, columns: Floats) -> Floats:
        image = self.surface.apply(columns)
        image *= self.smoothness
        image += self._shift_diagonal() * columns
        return image

    def _shift_diagonal(self) -> Floats:
        """Return g_i Ω + λ, (1, b) or (m, b)."""
        shifts = self.shifts[None]
        return (shifts if self.row_weights is None else self.row_weights * shifts) + self.ridge


def _dot_columns(left: Floats, right: Floats) -> Floats:
    return np.asarray(np.einsum("jb,jb->b", left, right))


def _divide(above: Floats, below: Floats) -> Floats:
    """Return the quotients; 0 where a column has nothing left to solve."""
    return np.divide(above, below, out=np.zeros_like(above), where=below > 0)
