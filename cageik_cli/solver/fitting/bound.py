"""The error of the best possible cage animation with n points: what no weights can be better than.

Displacements of all frames are a matrix D, (m, 3F); weights and cages give a matrix of rank n at
most. The best one leaves the singular values of D beyond n (Eckart and Young 1936). They are found
in one pass over the frames: with an orthonormal basis Q of the displacements of a sample, and λ_i
the eigenvalues of QᵀD DᵀQ, the sum of the n largest squared singular values of D is at least
Σ_{i ≤ n} λ_i, and at most that plus |D − QQᵀD|².
"""

from dataclasses import dataclass

import numpy as np

from cageik_cli.coordinates.fitting.displacements import Displacements
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.util.arrays import Floats

BASIS_TOL = 1e-7
"""Directions of the sample with smaller singular values, relative to the largest, are left out."""

SPARE_DIRECTIONS = 64
"""The basis has n directions and so many more, at most."""


@dataclass(frozen=True, slots=True)
class RankBound:
    """Bounds of the error of the best model with n points, in percent of the diagonal.

    Attributes
    ----------
    lowest, highest : float
        The error (root mean square over vertices and frames) is between them. They differ by what
        the basis leaves out.
    points : int
        n.
    """

    lowest: float
    highest: float
    points: int


class BoundAccumulator:
    """Accumulates the bound over all frames of a clip, block by block.

    Parameters
    ----------
    solver : DualLaplacianSolver
        It aligns the frames; its missing vertices do not count.
    sample : Displacements
        Frames that span nearly all displacements, as the sample that weights are fitted to.
    points : int
        n.
    """

    def __init__(self, solver: DualLaplacianSolver, sample: Displacements, points: int) -> None:
        self._solver, self._points = solver, points
        self._basis = _span(sample, solver, points + SPARE_DIRECTIONS)
        self._moments = np.zeros((self._basis.shape[1],) * 2)
        self._outside, self._count = 0.0, 0

    def update(self, frames: Floats) -> None:
        """Add frames, (k, m, 3)."""
        self.add_columns(self._solver.align(frames).columns)

    def add_columns(self, columns: Floats) -> None:
        """Add the displacements of frames, (m, 3k), aligned with the rest pose."""
        data = columns[self._solver.data_vertices]
        inside = self._basis.T @ data
        self._moments += inside @ inside.T
        data = data - self._basis @ inside
        self._outside += float(np.vdot(data, data))
        self._count += data.size // 3

    def finish(self) -> RankBound:
        """Return the bound over all frames added."""
        kept = np.linalg.eigvalsh(self._moments)[::-1]
        lowest = float(np.maximum(kept[self._points :], 0).sum())
        percent = 100 / self._solver.binding.rest.diagonal
        scale = max(self._count, 1)
        return RankBound(
            float(percent * np.sqrt(lowest / scale)),
            float(percent * np.sqrt((lowest + self._outside) / scale)),
            self._points,
        )


def bound_rank(solver: DualLaplacianSolver, target: Displacements, points: int) -> RankBound:
    """Return the bound for the frames of a sample; each counts as many times as it stands for."""
    accumulator = BoundAccumulator(solver, target, points)
    for columns in target.blocks():
        accumulator.add_columns(columns)
    found = accumulator.finish()
    scale = float(np.sqrt(len(target) / target.weight))
    return RankBound(scale * found.lowest, scale * found.highest, points)


def _span(sample: Displacements, solver: DualLaplacianSolver, most: int) -> Floats:
    """Return an orthonormal basis, (vertices, at most `most`), of the largest directions.

    From the eigenvectors of DᵀD, which is small; a second orthogonalisation removes their rounding.
    """
    counted = solver.data_vertices
    mask = np.zeros(len(solver.binding.weights))
    mask[counted] = 1
    values, vectors = np.linalg.eigh(sample.multiply_by_transpose(mask))
    values, vectors = values[::-1], vectors[:, ::-1]
    count = min(most, int(np.count_nonzero(values > BASIS_TOL**2 * values[0])))
    return np.asarray(np.linalg.qr(sample.multiply(vectors[:, :count])[counted])[0])
