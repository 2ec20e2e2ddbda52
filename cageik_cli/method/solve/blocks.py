"""The frames of a clip in blocks: solved, and measured.

A plain solve is one in which all weights of vertices are 1. In captured clips, vertices of one
frame may count differently than in another: missing ones have the weight 0.
"""

import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cageik_cli.captured.frames import FrameWeights, KeptBlock, complete_frames, measure_tolerances
from cageik_cli.captured.robust import RobustSolver
from cageik_cli.formats.base.sequence import Block, MeshSequence
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver, Solution
from cageik_cli.method.solve.metrics import (
    FrameMetrics,
    check_finite,
    leave_gaps,
    map_columns,
    measure,
    measure_kept,
)
from cageik_cli.method.solve.summary import DeviationPeaks
from cageik_cli.util.arrays import Floats, Integers, Mask, Workspace, spread_evenly
from cageik_cli.util.errors import FileAccessError, FormatError, InputError
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import to_unicode
from cageik_cli.util.threads import limit_blas_threads

MAX_TOLERANCE_FRAMES = 16
"""Frames on which residuals are measured, at most; they are spread evenly over the clip."""


@dataclass(frozen=True, slots=True, eq=False)
class SolvedBlock:
    """Consecutive frames, solved and measured.

    Attributes
    ----------
    start : int
        Number of the first frame.
    cages : (k, n, 3) float64
    rotations : (k, 3, 3) float64
        Of the rest pose to each frame. Both are nan for skipped frames.
    squared_errors : (m,) float64
        Sum of |v̂ − v|² of each vertex over frames that were not skipped; nan for missing data.
    peaks : DeviationPeaks
        The largest |v̂ − v| of each vertex over the same frames.
    digests : tuple of bytes
        SHA-256 of the file of each frame; zeros if it cannot be read.
    skipped : dict
        The reason for each skipped frame, by its number in the clip.
    sampled : (s, 3k) float32
        Displacements of some vertices, aligned with the rest pose and in its diagonals; zeros for
        skipped frames.
    kept : KeptBlock, optional
        What was kept, if vertices of one frame may count differently than in another. Squared
        errors and peaks are then of what was kept.
    """

    start: int
    cages: Floats
    rotations: Floats
    metrics: FrameMetrics
    squared_errors: Floats
    peaks: DeviationPeaks
    digests: tuple[bytes, ...]
    skipped: dict[int, str]
    sampled: NDArray[np.float32]
    kept: KeptBlock | None = None

    @property
    def stop(self) -> int:
        """Return the number of the frame after the last."""
        return self.start + len(self.cages)


class BlockSolver:
    """Solver and measurement of the blocks of a clip.

    Parameters
    ----------
    skips_bad_frames : bool
        Whether frames that cannot be read become gaps, as missing ones do; otherwise they are
        refused.
    robust : RobustSolver, optional
        Of frames whose vertices count differently; without it, all count alike.
    frame_weights : FrameWeights, optional
        Of each frame of the clip.
    accepts_gaps : bool
        Whether frames of too few data become gaps; otherwise they are refused.

    All parameters are attributes too.
    """

    def __init__(
        self,
        sequence: MeshSequence,
        solver: DualLaplacianSolver,
        progress: ProgressListener,
        *,
        skips_bad_frames: bool = False,
        robust: RobustSolver | None = None,
        frame_weights: FrameWeights | None = None,
        accepts_gaps: bool = False,
    ) -> None:
        self.sequence, self.solver, self.progress = sequence, solver, progress
        self.skips_bad_frames, self.accepts_gaps = skips_bad_frames, accepts_gaps
        self.robust, self.frame_weights = robust, frame_weights
        self._thread_local = threading.local()

    def solve_block(self, block: Block) -> SolvedBlock:
        """Solve and measure a block; frames of too few data become gaps.

        Raises
        ------
        InputError
            When a frame could not be read, or has too few data, and must not become a gap.
        NumericalError
            When the solve gives numbers that are not finite or too large.
        """
        if not self.skips_bad_frames:
            block.raise_read_errors(ignore_missing=True)
        digests = tuple(map(self.sequence.digest_or_zeros, range(block.start, block.stop)))
        with self.progress.stage("solve"):
            positions, given = self.complete(block)
            if self.robust is None:
                solution = self.solver.solve(positions, self._workspace)
            else:
                solution = self.robust.solve(positions, given, self._workspace)
                block = self._skip_thin_frames(block, given, solution)
            block = replace(block, positions=positions)
        with self.progress.stage("measure"):
            return self.measure_block(block, given, solution, digests)

    def find_tolerances(self) -> None:
        """Measure the residuals that each vertex may have: above them, it is an outlier.

        At most `MAX_TOLERANCE_FRAMES` are solved twice: their residuals give tolerances, with which
        those of the second time are not led astray by outliers.
        """
        assert self.robust is not None
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
        if self.robust is None:
            return block.positions, None
        weights = self.frame_weights
        given = None if weights is None else weights.read(block.start, block.stop)
        return complete_frames(self.solver, block.positions, given)

    def measure_block(
        self, block: Block, given: Floats | None, solution: Solution, digests: tuple[bytes, ...]
    ) -> SolvedBlock:
        """Measure a solved block, whose vertices all have positions and may count as `given`.

        Frames that could not be read are gaps.
        """
        rest, frames, rebuilt = self.solver.binding.rest, block.positions, solution.reconstructions
        if self.robust is None:
            measured = measure(rest, frames, rebuilt, self.solver.data_vertices, self._workspace)
            return make_solved_block(block, solution, *measured, digests)
        is_data = is_kept = self._find_data(frames, given)
        weights = np.ones(is_data.shape) if solution.weights is None else solution.weights
        if self.robust.tolerances is not None:
            # A small weight that is given is no outlier: only what is taken from it counts.
            is_kept = is_data & (weights >= (1.0 if given is None else given))
        metrics, squares = measure(rest, frames, rebuilt, is_data, is_kept=is_kept)
        kept = KeptBlock.of(
            measure_kept(squares, is_data, is_kept),
            weights,
            is_kept,
            gaps=_find_gaps(block),
        )
        return make_solved_block(block, solution, metrics, squares, digests, kept)

    @property
    def _workspace(self) -> Workspace:
        """Memory of this thread."""
        found: Workspace = self._thread_local.__dict__.setdefault("workspace", Workspace())
        return found

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
            reason = fault or f"fewer than the {least} vertices of the cage"
            errors[frame] = FormatError(
                f"{self.sequence.location(frame)}: {count} of {block.positions.shape[1]} vertices "
                f"are data ({reason})"
            )
        if errors and not self.accepts_gaps:
            raise FormatError(
                f"{errors[min(errors)]}; leave a gap by `on_bad_frame=skip`, or fill it by "
                "`fill_gaps=True`"
            )
        return replace(block, read_errors=block.read_errors | errors)


def make_solved_block(
    block: Block,
    solution: Solution,
    metrics: FrameMetrics,
    squares: Floats,
    digests: tuple[bytes, ...],
    kept: KeptBlock | None = None,
) -> SolvedBlock:
    """Return the cages and metrics of a block, with gaps for frames that could not be read.

    `squares` are its squared errors, (k, m), as of `measure`.
    """
    gaps = _find_gaps(block)
    known = np.delete(np.arange(len(solution.cages)), gaps)
    cages, rotations, sampled = solution.cages, solution.rotations, solution.sampled
    readable = map_columns(metrics, lambda column: column[known])
    check_finite(block.start + known, cages[known], readable)
    if len(gaps):
        squares, metrics = squares[known], leave_gaps(metrics, gaps)
        cages, rotations, sampled = cages.copy(), rotations.copy(), sampled.copy()
        cages[gaps] = rotations[gaps] = np.nan
        sampled.reshape(len(sampled), -1, 3)[:, gaps] = 0
    peaks = DeviationPeaks.of_frames(squares, block.start + known)
    if kept is not None:
        squares = np.nan_to_num(squares)
    return SolvedBlock(
        start=block.start,
        cages=cages,
        rotations=rotations,
        metrics=metrics,
        squared_errors=squares.sum(axis=0),
        peaks=peaks,
        digests=digests,
        skipped={k: to_unicode(str(error)) for k, error in block.read_errors.items()},
        sampled=sampled,
        kept=kept,
    )


def _find_gaps(block: Block) -> Integers:
    """Return the places of the frames of a block that could not be read, ascending."""
    return np.array(sorted(block.read_errors), np.int64) - block.start
