"""Weights that fit displacements best for given cages, affine-exact, smooth, near to harmonic.

With displacements D (m, 3k) of the model, B (n, 3k) of its cage, and s = tr(BBᵀ)/n, the weights
W = H + E minimise

    ‖Ω^½ (D − W B)‖² + λ s ‖E‖² + μ s ‖Λ E‖²,      E·1 = 0,  E·C = 0.

Rows of E are in the complement of span(1, C). In its basis Q of the eigenvectors of P BBᵀ P, with
eigenvalues s g_i, the columns of F = E Q separate, also with vertex weights Ω:

    (μ ΛᵀΛ + g_i Ω + λ) f_i = b_i,      b_i = Ω (D − H B) Bᵀ q_i / s.

A column lowers the sum by s |b_i|² / (g_i + λ) at most. The cage hardly moves in many directions
q_i; their columns are left 0.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from cageik_cli.coordinates.fitting.displacements import FRAMES_PER_BLOCK, Displacements
from cageik_cli.coordinates.fitting.systems import (
    Precision,
    ShiftedSystem,
    SurfaceLaplacian,
    count_columns,
)
from cageik_cli.util.arrays import Floats
from cageik_cli.util.threads import OrderedMap


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """A change of weights, E = `columns @ basis.T`.

    Attributes
    ----------
    columns : (m, r) float64
    basis : (n, r) float64
        Orthonormal, and orthogonal to 1 and to the cage's coordinates.
    """

    columns: Floats
    basis: Floats

    @staticmethod
    def none(m: int, n: int) -> "Correction":
        """Return the change of (m, n) weights that changes nothing."""
        return Correction(np.empty((m, 0)), np.empty((n, 0)))

    @staticmethod
    def join(parts: Iterable["Correction"], m: int, basis: Floats) -> "Correction":
        """Join changes whose bases are different columns of `basis`, (n, r), in this order."""
        columns, kept = np.empty((m, basis.shape[1])), np.empty_like(basis)
        count = 0
        for part in parts:
            end = count + part.basis.shape[1]
            columns[:, count:end], kept[:, count:end] = part.columns, part.basis
            count = end
        return Correction(columns[:, :count], kept[:, :count])

    def express(self, basis: Floats) -> Floats:
        """Return E times basis vectors (n, b), as (m, b)."""
        return np.asarray(self.columns @ (self.basis.T @ basis))

    def add_to(self, weights: Floats) -> Floats:
        """Return `weights`, (m, n), with the change."""
        changed = self.columns @ self.basis.T
        changed += weights
        return np.asarray(changed)


@dataclass(frozen=True, slots=True, eq=False)
class WeightProblem:
    """What does not change while cages and weights are fitted to each other.

    Attributes
    ----------
    rest_weights : (m, n) float64
        H, affine-exact.
    vertex_weights : (m,) float64 or None
        The diagonal of Ω: not negative, 0 for missing data.
    regularization : float
        λ, above 0.
    smoothness : float
        μ, 0 or above.
    """

    rest_weights: Floats
    surface: SurfaceLaplacian
    vertex_weights: Floats | None
    regularization: float
    smoothness: float

    def fit(
        self,
        motion: "Motion",
        subspace: Floats,
        start: Correction | None = None,
        solving: "Solving | None" = None,
    ) -> Correction:
        """Return the best change of the weights whose rows are in `subspace`.

        Parameters
        ----------
        subspace : (n, r)
            Orthonormal, for instance `complement_basis`.
        start : Correction, optional
            A first guess.
        """
        solving = solving or Solving()
        basis, gains = diagonalize(motion.cages, subspace)
        scale = motion.scale
        if not scale:
            return Correction(np.zeros((len(self.rest_weights), basis.shape[1])), basis)

        m, width = len(self.rest_weights), count_columns(len(self.rest_weights))

        def solve_columns(first: int) -> Correction:
            block = slice(first, first + width)
            right = self.project_residual(motion, basis[:, block])
            right /= scale
            reached = np.square(right).sum(axis=0) / (gains[block] / scale + self.regularization)
            kept = np.flatnonzero(reached * len(basis) > solving.precision.negligible**2 * m)
            directions = basis[:, first + kept]
            guess = None if start is None else start.express(directions)
            system = self.make_system(gains[first + kept] / scale)
            right = np.ascontiguousarray(right[:, kept])
            return Correction(system.solve(right, guess, solving.precision), directions)

        starts = range(0, basis.shape[1], width)
        with OrderedMap(solve_columns, starts, solving.jobs, solving.jobs) as solved:
            return Correction.join(solved, m, basis)

    def add_change(self, change: Correction) -> Floats:
        """Return the weights, (m, n), with a change."""
        return change.add_to(self.rest_weights)

    def make_system(self, shifts: Floats) -> ShiftedSystem:
        """Return the systems of columns with the given g_i, (b,)."""
        rows = None if self.vertex_weights is None else self.vertex_weights[:, None]
        return ShiftedSystem(self.surface, self.smoothness, self.regularization, rows, shifts)

    def project_residual(self, motion: "Motion", basis: Floats) -> Floats:
        """Return Ω (D − H B) Bᵀ times basis vectors (n, b), as (m, b)."""
        along = motion.cages.T @ basis
        right = motion.target.multiply(along)
        right -= self.rest_weights @ (motion.cages @ along)
        if self.vertex_weights is not None:
            right *= self.vertex_weights[:, None]
        return right


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Displacements of a model and of its cage.

    Attributes
    ----------
    target : Displacements
        D, of k frames.
    cages : (n, 3k) float64
        B.
    least : float
        Displacements per coordinate and frame, as root mean squares, below which a motion may be
        rounding: s does not fall with them, so that weights are not fitted to noise.
    """

    target: Displacements
    cages: Floats
    least: float = 0.0

    @property
    def scale(self) -> float:
        """Return s, the mean of squared displacements of a cage vertex, summed over frames.

        0 if and only if nothing moves.
        """
        moved = float(np.square(self.cages).sum() / len(self.cages))
        return max(moved, 3 * self.target.weight * self.least**2) if moved else 0.0


@dataclass(frozen=True, slots=True)
class Solving:
    """How the systems are solved: to which precision, by how many threads."""

    precision: Precision = field(default_factory=Precision)
    jobs: int = 1


WEIGHT_MATRICES = 3
"""Arrays (m, n) in memory at most: H, and two of the changes before and after or the weights."""

WORK_ARRAYS = 9
"""Arrays of a block of columns per thread."""


def estimate_memory(m: int, n: int, jobs: int) -> int:
    """Return the bytes that a fit of (m, n) weights takes beside the displacements."""
    per_thread = WORK_ARRAYS * count_columns(m) + 2 * 3 * FRAMES_PER_BLOCK
    return 8 * m * (WEIGHT_MATRICES * n + jobs * per_thread)


def diagonalize(cages: Floats, subspace: Floats) -> tuple[Floats, Floats]:
    """Return a basis of `subspace`, (n, r), that diagonalises BBᵀ in it, and its eigenvalues, (r,).

    The eigenvalues ascend and are not negative.
    """
    along = cages.T @ subspace
    values, vectors = np.linalg.eigh(along.T @ along)
    return subspace @ vectors, np.maximum(values, 0)
