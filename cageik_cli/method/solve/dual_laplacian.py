"""The solver for the cages of all frames: one factored normal matrix, many right-hand sides.

The cage of a frame v minimises

    (α/n) Σ_i |(L c)_i − δ_i|²  +  (β/m) Σ_j w_j |v_j − Σ_k H_jk c_k|²,      δ = L c_rest

(Savoye and Franco 2010, eq. 6, in means instead of sums, so that α and β mean the same on every
mesh; w has mean one). In displacements d = c − c_rest each frame is a right-hand side of the system

    [(α/n) LᵀL + (β/m) HᵀW H] d = (β/m) HᵀW (v − H c_rest),

in which nothing large cancels, and the rest pose gives the rest cage exactly. A norm above 2 then
lowers the largest deviations, see `norm.py`.
"""

from dataclasses import asdict, dataclass, field

import numpy as np
from numpy.typing import NDArray

from cageik_cli.geometry.points import columns_to_frames, frames_to_columns, place_columns
from cageik_cli.geometry.shape import uniform_laplacian
from cageik_cli.method.solve.alignment import best_motions, centroids, move_to_rest
from cageik_cli.method.solve.norm import MIN_LIMIT, DeviationNorm
from cageik_cli.method.solve.settings import LEAST_SQUARES, SolveSettings
from cageik_cli.method.solve.vertex_weights import drop_unused_vertices
from cageik_cli.method.weights.binding import Binding, Poses, WeightQuality
from cageik_cli.util.arrays import Floats, Integers, Workspace, spread_evenly
from cageik_cli.util.errors import NumericalError
from cageik_cli.util.messages import say
from cageik_cli.util.text import group_digits

MAX_CONDITION = 1e12
"""Normal matrices with a larger condition number are refused."""

MIN_REFINED_CONDITION = 1e6
"""Above it, a step of refinement recovers digits that the normal matrix has lost."""

MIN_BOUND_VERTICES, MAX_BOUND_VERTICES = 512, 1024
"""Vertices on which the best possible error is found; within these limits, 8 per cage vertex."""


@dataclass(frozen=True, slots=True)
class SolveQuality(WeightQuality):
    """Measures of the quality of the weights, and of the system that they give.

    Attributes
    ----------
    condition_number : float
        Of the normal matrix, in the 2-norm.
    """

    condition_number: float


@dataclass(frozen=True, slots=True, eq=False)
class Solution(Poses):
    """The cages and the rotations of k frames.

    Attributes
    ----------
    reconstructions : (k, m, 3) float64
        `weights @ cage` of each frame, and the turned offsets of a binding that has them.
    sampled : (s, 3k) float32
        Aligned displacements of the solver's `sampled_vertices`, in diagonals of the rest pose, so
        that they fit single precision in any units. Where a vertex is missing or rejected, they
        are those of the reconstruction.
    weights : (k, m) float64, optional
        How much each vertex counts in each frame, 0 if it is missing; None if all count alike.
    faults : dict
        Why a frame, by its place among the k, has no solution.
    """

    rotations: Floats
    reconstructions: Floats
    sampled: NDArray[np.float32]
    weights: Floats | None = None
    faults: dict[int, str] = field(default_factory=dict)


class DualLaplacianSolver:
    """Solver for the cages of any number of frames, with one factorisation.

    Parameters
    ----------
    vertex_weights : (m,) float64, optional
        From `normalize_weights`; ones by default. A vertex of weight 0 is missing data, and one in
        no face has weight 0.

    Attributes
    ----------
    data_vertices : (c,) int64 or a slice of all
        Vertices that are data: all but those of weight 0.
    missing_count : int
        Number of vertices of weight 0 that are in a face.
    sampled_vertices : (s,) int64
        Vertices that are data, spread over their numbers: what is possible is measured on them.
    vertex_weights : (m,) float64
    rest : (m, 3) float64
    rest_cage : (n, 3) float64
        Both relative to the weighted centroid of the rest pose.
    smoothness, normal : (n, n) float64
        (α/n) LᵀL, and the normal matrix.
    data_scale : float
        β/m.

    Raises
    ------
    NumericalError
        When the normal matrix is singular to working precision.
    """

    def __init__(
        self, binding: Binding, settings: SolveSettings, vertex_weights: Floats | None = None
    ) -> None:
        m, n = binding.weights.shape
        vertex_weights = drop_unused_vertices(vertex_weights, binding.rest)
        self.binding = binding
        self.is_aligned = settings.align
        self.vertex_weights = np.ones(m) if vertex_weights is None else vertex_weights
        self._is_weighted = vertex_weights is not None
        is_data = self.vertex_weights != 0
        self.missing_count = int(np.count_nonzero(binding.rest.is_used & ~is_data))
        self.data_count = int(np.count_nonzero(is_data))
        self.data_vertices = slice(None) if is_data.all() else np.flatnonzero(is_data)
        self.sampled_vertices = spread_vertices(np.arange(m)[self.data_vertices], n)
        self._diagonal = binding.rest.diagonal
        self._origin = self.vertex_weights @ binding.rest.vertices / m
        self.rest = binding.rest.vertices - self._origin
        self.rest_cage = binding.cage.vertices - self._origin
        self._weights = binding.weights
        self._offsets = binding.offsets
        # Only their ratio matters; the larger is scaled to 1, so that nothing overflows.
        alpha, beta = np.array([settings.alpha, settings.beta]) / max(settings.alpha, settings.beta)
        self.data_scale = beta / m
        laplacian = uniform_laplacian(binding.cage)
        self.smoothness = (alpha / n) * laplacian.T @ laplacian
        data = self.weigh_data(self.vertex_weights)
        condition = self._validate_condition(data)
        self.quality = SolveQuality(**asdict(binding.quality), condition_number=condition)
        self.normal = self.smoothness + data
        # Products with the inverse of the factor are quicker than substitutions, and for columns
        # of data as exact: the error grows with the root of the condition number, twice.
        self._inverse_factor = np.linalg.inv(np.linalg.cholesky(self.normal))
        self._norm: DeviationNorm | None = None
        if settings.norm is not None and settings.norm > LEAST_SQUARES:
            self._norm = DeviationNorm(
                settings.norm,
                normal=self.normal,
                weights=self._weights,
                vertex_weights=self.vertex_weights,
                data_scale=self.data_scale,
                least=MIN_LIMIT * self._diagonal,
            )

    def solve(self, frames: Floats, workspace: Workspace | None = None) -> Solution:
        """Return the cages of `frames`, (k, m, 3).

        With `workspace`, the reconstructions are valid until it is used again.
        """
        workspace = workspace or Workspace()
        columns, centres, rotations = self.align(frames, workspace)
        sampled = self._scale_sample(columns[self.sampled_vertices])
        displaced = columns_to_frames(self.solve_frames(columns, workspace))
        turned = (self.rest_cage + displaced) @ rotations
        np.matmul(self._weights, frames_to_columns(turned), out=columns)
        moved = workspace.array("moved", *frames.shape)
        place_columns(columns, centres, moved)
        if self._offsets is not None:
            moved += self._offsets @ rotations
        return Solution(turned + centres[:, None], rotations, moved, sampled.astype(np.float32))

    def align(
        self, frames: Floats, workspace: Workspace | None = None
    ) -> tuple[Floats, Floats, Floats]:
        """Move `frames`, (k, m, 3), onto the rest pose.

        Returns
        -------
        columns : (m, 3k) float64
            R (v − centre) − (rest − origin) of each frame: its displacements from the rest pose.
            With `workspace`, they are valid until it is used again.
        centres : (k, 3) float64
        rotations : (k, 3, 3) float64
            R; `points @ R` turns points of the rest pose to the frame.
        """
        workspace = workspace or Workspace()
        centres = np.tile(self._origin, (len(frames), 1))
        rotations = np.tile(np.eye(3), (len(frames), 1, 1))
        if self.is_aligned:
            centres, rotations = best_motions(frames, self.rest, self.vertex_weights)
        columns = workspace.array("columns", len(self.rest), 3 * len(frames))
        move_to_rest(frames, centres, rotations, self.rest, columns)
        return columns, centres, rotations

    def sample(self, frame: Floats, rotation: Floats) -> Floats:
        """Return the displacements of `sampled_vertices` of a frame, (s, 3), as in a solution.

        The frame, (m, 3), is aligned with the rest pose by its rotation, (3, 3).
        """
        centre = self._origin
        if self.is_aligned:
            centre = centroids(frame[None], self.vertex_weights)[0]
        chosen = self.sampled_vertices
        moved = (frame[chosen] - centre) @ rotation.T - self.rest[chosen]
        return self._scale_sample(moved)

    def _scale_sample(self, displacements: Floats) -> Floats:
        """Return displacements in diagonals; those that fit no single precision are shortened."""
        return np.clip(displacements / self._diagonal, -1e30, 1e30)

    def solve_frames(self, target: Floats, workspace: Workspace | None = None) -> Floats:
        """Return the cage displacements (n, 3k) of k frames, (m, 3k), in the norm of the settings.

        For least squares these are those of `solve_displacements`.
        """
        displaced = self.solve_displacements(target)
        if self._norm is not None:
            residuals = (workspace or Workspace()).array("residuals", *target.shape)
            np.matmul(self._weights, displaced, out=residuals)
            displaced += self._norm.correct(np.subtract(target, residuals, out=residuals))
        return displaced

    def solve_displacements(self, target: Floats) -> Floats:
        """Return the cage displacements (n, 3k) that fit vertex displacements (m, 3k) best.

        That is by least squares, also for columns that are no frames.

        Refinement computes the residual over the vertices, without the normal matrix (Björck 1987,
        the corrected seminormal equations).
        """
        displaced = self._back_substitute(self._normal_rhs(target))
        if self.quality.condition_number > MIN_REFINED_CONDITION:
            residual = target - self._weights @ displaced
            displaced += self._back_substitute(
                self._normal_rhs(residual) - self.smoothness @ displaced
            )
        return displaced

    def _normal_rhs(self, columns: Floats) -> Floats:
        """Return (β/m) HᵀW times columns (m, 3k), as (n, 3k)."""
        weighted = self.vertex_weights[:, None] * columns if self._is_weighted else columns
        return np.asarray(self.data_scale * (self._weights.T @ weighted))

    def _back_substitute(self, columns: Floats) -> Floats:
        """Return the inverse of the normal matrix times columns (n, 3k)."""
        return np.asarray(self._inverse_factor.T @ (self._inverse_factor @ columns))

    def _validate_condition(self, data: Floats) -> float:
        """Return the condition number of the smoothness plus `data`, (n, n); refuse a large one."""
        eigenvalues = np.linalg.eigvalsh(self.smoothness + data)
        smallest, largest = float(eigenvalues[0]), float(eigenvalues[-1])
        condition = largest / smallest if smallest > 0 else float("inf")
        if condition <= MAX_CONDITION:
            return condition
        n = len(data)
        remedy = say(
            "raise `alpha=`, whose default is 1e-3, or remove cage vertices far from the model"
        )
        if not data.any():
            remedy = say(
                "raise `beta=` above 0: without vertices the position of the cage is undefined"
            )
        elif np.trace(self.smoothness) > np.trace(data):
            remedy = say(
                "lower `alpha=`, whose default is 1e-3: the Laplacian outweighs the vertices"
            )
        elif self.data_count < n:
            remedy = (
                f"{group_digits(self.data_count)} vertices that are data cannot determine {n} cage "
                "vertices: "
                + say("raise `alpha=`, whose default is 1e-3, or take a cage of at most ")
                + f"{group_digits(self.data_count)} vertices"
            )
        weakest = int(np.argmin(np.abs(self._weights).max(axis=0)))
        raise NumericalError(
            f"the system is singular (condition number {condition:.1e}, limit {MAX_CONDITION:.0e}; "
            f"the least influential cage vertex is {weakest}); " + remedy
        )

    def weigh_data(self, weights: Floats, rows: Integers | None = None) -> Floats:
        """Return (β/m) Σ_j weights_j H_jᵀ H_j, (n, n), over all vertices, or those of `rows`.

        It is summed over blocks: a weighted copy of H may not fit.
        """
        n = self._weights.shape[1]
        size = max(1, (1 << 22) // n)
        data = np.zeros((n, n))
        for start in range(0, len(weights), size):
            block = slice(start, start + size)
            chosen = self._weights[block if rows is None else rows[block]]
            roots = np.sqrt(weights[block, None]) * chosen
            data += roots.T @ roots
        return np.asarray(self.data_scale * data)


def spread_vertices(numbers: Integers, points: int) -> Integers:
    """Choose vertices for a cage of `points`, spread over the given numbers; all of a few."""
    count = min(max(MIN_BOUND_VERTICES, 8 * points), MAX_BOUND_VERTICES)
    if count >= len(numbers):
        return numbers
    return np.asarray(numbers[spread_evenly(len(numbers), count)])
