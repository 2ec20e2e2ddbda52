"""Frames of captured clips: missing vertices, what is no outlier, and what was kept.

What a cage cannot follow is no outlier: the residuals that each vertex may have are measured.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Protocol

import numpy as np

from cageik_cli.captured.robust import RobustSolver
from cageik_cli.geometry.frames import Block
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import lumped_areas
from cageik_cli.method.solve.alignment import best_rotations
from cageik_cli.method.solve.blocks import (
    BlockSolver,
    Clip,
    KeptBlock,
    SolvedBlock,
    make_solved_block,
)
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver, Solution
from cageik_cli.method.solve.metrics import measure, measure_kept
from cageik_cli.util.arrays import Floats, Mask, spread_evenly
from cageik_cli.util.errors import FileAccessError, FormatError, InputError
from cageik_cli.util.messages import say
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import group_digits
from cageik_cli.util.threads import limit_blas_threads

MAX_TOLERANCE_FRAMES = 16
"""Frames on which residuals are measured, at most; they are spread evenly over the clip."""

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
    completed, rest = positions.copy(), solver.binding.rest.vertices
    for place in np.flatnonzero(is_missing.any(axis=1)):
        frame, missing = completed[place], is_missing[place]
        known = np.flatnonzero((weights[place] > 0) & (solver.vertex_weights > 0) & ~missing)
        if not solver.is_aligned or not len(known):
            frame[missing] = rest[missing]
            continue
        centre, origin = frame[known].mean(axis=0), rest[known].mean(axis=0)
        turn = np.eye(3)
        if len(known) >= 3:  # fewer do not tell how the frame is turned
            ones = np.ones(len(known))
            turn = best_rotations((frame[known] - centre)[None], rest[known] - origin, ones)[0]
        frame[missing] = (rest[missing] - origin) @ turn + centre
    return completed, weights


def measure_tolerances(
    robust: RobustSolver, frames: Iterable[tuple[Floats, Floats | None]]
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


class CapturedBlockSolver(BlockSolver[Clip]):
    """Solver and measurement of blocks whose vertices may count differently in each frame.

    Missing vertices have the weight 0.

    Parameters
    ----------
    robust : RobustSolver
    frame_weights : FrameWeights, optional
        Of each frame of the clip.
    accepts_gaps : bool
        Whether frames of too few data become gaps; otherwise they are refused.

    All parameters are attributes too, and those of `BlockSolver`.
    """

    def __init__(
        self,
        sequence: Clip,
        robust: RobustSolver,
        progress: ProgressListener,
        *,
        skips_bad_frames: bool = False,
        frame_weights: FrameWeights | None = None,
        accepts_gaps: bool = False,
    ) -> None:
        super().__init__(sequence, robust.solver, progress, skips_bad_frames=skips_bad_frames)
        self.robust, self.frame_weights = robust, frame_weights
        self.accepts_gaps = accepts_gaps

    def find_tolerances(self) -> None:
        """Measure the residuals that each vertex may have: above them, it is an outlier.

        At most `MAX_TOLERANCE_FRAMES` are solved twice: their residuals give tolerances, with which
        those of the second time are not led astray by outliers.
        """
        with self.progress.stage("solve"), limit_blas_threads(1):
            for _ in range(2):
                tolerances = measure_tolerances(self.robust, self._read_some(MAX_TOLERANCE_FRAMES))
                self.robust = RobustSolver(self.solver, tolerances)

    def _read_some(self, most: int) -> Iterator[tuple[Floats, Floats | None]]:
        """Read evenly spread frames, one by one, as of `complete`."""
        is_any = False
        for index in spread_evenly(len(self.sequence), most).tolist():
            if index in self.sequence.missing:
                continue
            try:
                positions = self.sequence.read_frame(index)[None]
            except InputError:
                if not self.skips_bad_frames:
                    raise
                continue
            is_any = True
            yield self.complete(Block(index, positions, {}))
        if not is_any:
            raise FileAccessError("none of the frames on which tolerances are measured can be read")

    def complete(self, block: Block) -> tuple[Floats, Floats | None]:
        """Return the frames of a block with a position for every vertex, and given weights.

        Both are as of `complete_frames`.
        """
        weights = self.frame_weights
        given = None if weights is None else weights.read(block.start, block.stop)
        return complete_frames(self.solver, block.positions, given)

    def _solve_and_measure(self, block: Block, digests: tuple[bytes, ...]) -> SolvedBlock:
        """Solve and measure a block, whose frames of too few data become gaps, too."""
        with self.progress.stage("solve"):
            positions, given = self.complete(block)
            solution = self.robust.solve(positions, given, self._workspace)
            block = replace(self._skip_thin_frames(block, given, solution), positions=positions)
        with self.progress.stage("measure"):
            return self.measure_block(block, given, solution, digests)

    def measure_block(
        self, block: Block, given: Floats | None, solution: Solution, digests: tuple[bytes, ...]
    ) -> SolvedBlock:
        """Measure a solved block, whose vertices all have positions and may count as `given`.

        Frames that could not be read are gaps.
        """
        rest, frames, rebuilt = self.solver.binding.rest, block.positions, solution.reconstructions
        is_data = is_kept = self._find_data(frames, given)
        weights = np.ones(is_data.shape) if solution.weights is None else solution.weights
        if self.robust.tolerances is not None:
            # A small weight that is given is no outlier: only what is taken from it counts.
            is_kept = is_data & (weights >= (1.0 if given is None else given))
        metrics, squares = measure(rest, frames, rebuilt, is_data, is_kept=is_kept)
        kept_metrics = measure_kept(squares, is_data, is_kept, lumped_areas(rest))
        kept = KeptBlock.of(kept_metrics, weights, is_kept, gaps=block.gaps)
        squares = np.where(is_kept, squares, np.nan)
        return make_solved_block(block, solution, metrics, squares, digests, kept)

    def _find_data(self, frames: Floats, given: Floats | None) -> Mask:
        """Return which vertices of each frame are data, (k, m)."""
        is_data = np.broadcast_to(self.solver.vertex_weights > 0, frames.shape[:2])
        return is_data if given is None else is_data & (given > 0)

    def _skip_thin_frames(self, block: Block, given: Floats | None, solution: Solution) -> Block:
        """Return the block with an error for each frame of too few data."""
        errors: dict[int, InputError] = {}
        least = solution.cages.shape[1]
        counts = self._find_data(block.positions, given).sum(axis=1)
        for place, count in enumerate(counts):
            fault, frame = solution.faults.get(place), block.start + place
            if (count >= least and fault is None) or frame in block.read_errors:
                continue
            reason = fault or f"fewer than the {group_digits(least)} vertices of the cage"
            errors[frame] = FormatError(
                f"{self.sequence.location(frame)}: {count} of {block.positions.shape[1]} vertices "
                f"are data ({reason})"
            )
        if errors and not self.accepts_gaps:
            raise FormatError(
                f"{errors[min(errors)]}; "
                + say("leave a gap by `on_bad_frame=skip`, or fill it by `fill_gaps=True`")
            )
        return replace(block, read_errors=block.read_errors | errors)
