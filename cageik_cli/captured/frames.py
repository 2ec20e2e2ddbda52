"""Frames of captured clips: missing vertices, what is no outlier, and what was kept.

What a cage cannot follow is no outlier: the residuals that each vertex may have are measured.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cageik_cli.captured.robust import RobustSolver
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.solve.alignment import best_rotations
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.metrics import KeptMetrics, leave_gaps
from cageik_cli.util.arrays import Floats, Integers, Mask

MAX_RESIDUAL_RATIO = 5.0
"""Tolerance, in the sum of the median residuals of a vertex and of all vertices."""

MIN_TOLERANCE = 1e-5
"""Smallest tolerance, in diagonals: rounding of single precision is far below."""


class FrameWeights(Protocol):
    """Weights of the vertices of each frame of a clip."""

    def read(self, start: int, stop: int) -> Floats:
        """Read the weights of frames `start` up to `stop`, exclusive: (k, m), from 0 to 1."""


def complete_frames(
    solver: DualLaplacianSolver, positions: Floats, given: Floats | None
) -> tuple[Floats, Floats | None]:
    """Give missing vertices, which are nan in positions (k, m, 3), a position and the weight 0.

    They are put where the rest pose has them, moved rigidly onto the others. Given and returned
    weights, (k, m), are from 0 to 1; None if all are 1.
    """
    is_missing = np.isnan(positions[..., 0])
    if not is_missing.any():
        return positions, given
    weights = np.ones(is_missing.shape) if given is None else given.copy()
    weights[is_missing] = 0
    completed = positions.copy()
    for place in np.flatnonzero(is_missing.any(axis=1)):
        completed[place] = _complete_frame(solver, positions[place], weights[place])
    return completed, weights


def _complete_frame(solver: DualLaplacianSolver, frame: Floats, weights: Floats) -> Floats:
    is_missing = np.isnan(frame[:, 0])
    rest = solver.binding.rest.vertices
    known = np.flatnonzero((weights > 0) & (solver.vertex_weights > 0) & ~is_missing)
    filled = frame.copy()
    if not solver.is_aligned or not len(known):
        filled[is_missing] = rest[is_missing]
        return filled
    centre, origin = frame[known].mean(axis=0), rest[known].mean(axis=0)
    turn = np.eye(3)
    if len(known) >= 3:  # fewer do not tell how the frame is turned
        ones = np.ones(len(known))
        turn = best_rotations((frame[known] - centre)[None], rest[known] - origin, ones)[0]
    filled[is_missing] = (rest[is_missing] - origin) @ turn + centre
    return filled


def measure_tolerances(
    robust: RobustSolver,
    frames: Iterable[tuple[Floats, Floats | None]],
) -> Floats:
    """Measure the tolerances of all vertices on some frames.

    The residual of a vertex is the median over the frames, and then over its neighbours in the
    mesh, so that a vertex that is off in all frames is found too.

    Parameters
    ----------
    robust : RobustSolver
        With the tolerances that are known so far, if any are.
    frames : iterable of ((1, m, 3), (1, m) or None)
        From `complete_frames`, one frame each, so that the result does not depend on the size of
        blocks.

    Returns
    -------
    (m,) float64, file units
    """
    rest = robust.solver.binding.rest
    rows = []
    for positions, weights in frames:
        found = robust.solve(positions, weights)
        if found.faults:
            continue
        errors = positions[0] - found.reconstructions[0]
        residuals = np.sqrt(np.einsum("jx,jx->j", errors, errors))
        is_data = robust.solver.vertex_weights > 0
        if weights is not None:
            is_data = is_data & (weights[0] > 0)
        rows.append(np.where(is_data, residuals, np.nan))
    smallest = MIN_TOLERANCE * rest.diagonal
    # The rest pose is met exactly, and says nothing of the others.
    rows = [row for row in rows if np.nanmax(row, initial=0) > smallest] or rows
    if not rows:
        return np.full(len(rest.vertices), smallest)
    typical = take_ring_medians(rest, take_medians(np.stack(rows)))
    middle = float(np.median(typical[np.isfinite(typical)]))
    typical = np.where(np.isfinite(typical), typical, middle)
    return np.asarray(np.maximum(MAX_RESIDUAL_RATIO * (typical + middle), smallest))


def take_medians(rows: Floats) -> Floats:
    """Return the medians of the columns of (k, m), without nan; nan where all are."""
    ordered = np.sort(rows, axis=0)  # nan is last
    counts = np.isfinite(rows).sum(axis=0)
    places = np.stack([np.maximum(counts - 1, 0) // 2, np.maximum(counts, 1) // 2])
    places = np.minimum(places, len(rows) - 1)
    return np.asarray(np.take_along_axis(ordered, places, axis=0).mean(axis=0))


def take_ring_medians(mesh: TriMesh, values: Floats) -> Floats:
    """Return the (lower) median of each vertex and its neighbours, (m,), without nan."""
    ends, own = mesh.edges.ends, np.arange(len(values))
    centres = np.concatenate([own, ends[:, 0], ends[:, 1]])
    found = np.concatenate([values, values[ends[:, 1]], values[ends[:, 0]]])
    centres, found = centres[np.isfinite(found)], found[np.isfinite(found)]
    order = np.lexsort((found, centres))
    counts = np.bincount(centres, minlength=len(values))
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    medians = np.full(len(values), np.nan)
    known = np.flatnonzero(counts)
    medians[known] = found[order][starts[known] + (counts[known] - 1) // 2]
    return medians


@dataclass(frozen=True, slots=True, eq=False)
class KeptBlock:
    """What was kept of k frames.

    Attributes
    ----------
    metrics : KeptMetrics
        nan, and -1 for counts, of skipped frames.
    starts : (k + 1,) int64
        Where the weights that are not 1 begin and end for each frame; skipped ones have none.
    vertices : (e,) int64
    weights : (e,) float64
    counts : (m,) int64
        Frames in which each vertex was kept.
    """

    metrics: KeptMetrics
    starts: Integers
    vertices: Integers
    weights: Floats
    counts: Integers

    @staticmethod
    def of(metrics: KeptMetrics, weights: Floats, is_kept: Mask, gaps: Integers) -> "KeptBlock":
        """Return what was kept of k frames with weights (k, m); `gaps` have nothing."""
        weights = weights.copy()
        weights[gaps] = 1
        frames, vertices = np.nonzero(weights != 1)
        return KeptBlock(
            metrics=leave_gaps(metrics, gaps),
            starts=np.searchsorted(frames, np.arange(len(weights) + 1)),
            vertices=vertices,
            weights=weights[frames, vertices],
            counts=np.delete(is_kept, gaps, axis=0).sum(axis=0),
        )

    def get_weights(self, place: int) -> tuple[Integers, Floats]:
        """Return the vertices of a frame whose weight is not 1, by its place, and these weights."""
        entries = slice(self.starts[place], self.starts[place + 1])
        return self.vertices[entries], self.weights[entries]

    def expand_weights(self, vertex_count: int) -> Floats:
        """Return all weights, (k, m)."""
        weights = np.ones((len(self.starts) - 1, vertex_count))
        for place, row in enumerate(weights):
            vertices, values = self.get_weights(place)
            row[vertices] = values
        return weights
