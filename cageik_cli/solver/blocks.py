"""The frames of a clip in blocks: read ahead, solved, measured, summarised."""

import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.sequence import Block, FramePrefetcher, MeshSequence
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver, Solution
from cageik_cli.solver.kept import KeptBlock
from cageik_cli.solver.memory_plan import MemoryPlan
from cageik_cli.solver.metrics import (
    METRIC_TYPES,
    FrameErrors,
    FrameMetrics,
    check_finite,
    measure,
)
from cageik_cli.solver.robust import RobustSolver
from cageik_cli.solver.summary import DeviationPeaks
from cageik_cli.util.arrays import Floats, Workspace
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import to_unicode
from cageik_cli.util.threads import OrderedMap


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

    def get_cage(self, frame: int) -> Floats:
        """Return the cage, (n, 3), of a frame, by its number in the clip."""
        return np.asarray(self.cages[frame - self.start])


def make_solved_block(
    block: Block, solution: Solution, errors: FrameErrors, digests: tuple[bytes, ...]
) -> SolvedBlock:
    """Return the cages and metrics of a block, with gaps for frames that could not be read."""
    faults = {k: to_unicode(str(error)) for k, error in block.read_errors.items()}
    metrics, squares = errors.metrics, errors.squared_errors
    frames = np.arange(block.start, block.start + len(solution.cages))
    cages, rotations, sampled = solution.cages, solution.rotations, solution.sampled
    if faults:
        gaps = np.array(list(faults)) - block.start
        squares, frames = np.delete(squares, gaps, axis=0), np.delete(frames, gaps)
        columns = {name: getattr(metrics, name).copy() for name in METRIC_TYPES}
        for name, column in columns.items():
            column[gaps] = -1 if METRIC_TYPES[name] == "i8" else np.nan
        cages, rotations, sampled = cages.copy(), rotations.copy(), sampled.copy()
        cages[gaps] = rotations[gaps] = np.nan
        sampled.reshape(len(sampled), -1, 3)[:, gaps] = 0
        metrics = FrameMetrics(**columns)
    return SolvedBlock(
        start=block.start,
        cages=cages,
        rotations=rotations,
        metrics=metrics,
        squared_errors=squares.sum(axis=0),
        peaks=DeviationPeaks.of_frames(squares, frames),
        digests=digests,
        skipped=faults,
        sampled=sampled,
    )


class CaptureSolver(Protocol):
    """Solves blocks in which vertices of one frame may count differently than in another."""

    @property
    def robust(self) -> RobustSolver:
        """The solver of frames."""

    def solve_block(self, block: Block, workspace: Workspace) -> Any:
        """Solve a block; frames of too few data become gaps."""

    def measure_block(self, found: Any, digests: tuple[bytes, ...]) -> SolvedBlock:
        """Measure what `solve_block` returned."""


class BlockSolver:
    """Solver and measurement of the blocks of a clip.

    Parameters
    ----------
    skips_bad_frames : bool
        Whether frames that cannot be read become gaps, as missing ones do; otherwise they are
        refused.
    capture : CaptureSolver, optional
        Solves the blocks, if vertices of one frame may count differently than in another.

    All parameters are attributes too.
    """

    def __init__(
        self,
        sequence: MeshSequence,
        solver: DualLaplacianSolver,
        skips_bad_frames: bool,
        progress: ProgressListener,
        capture: CaptureSolver | None = None,
    ) -> None:
        self.sequence, self.solver, self.progress = sequence, solver, progress
        self.capture = capture
        self._thread_local = threading.local()
        self.skips_bad_frames = skips_bad_frames

    def solve_block(self, block: Block) -> SolvedBlock:
        """Solve and measure a block.

        Raises
        ------
        InputError
            When a frame could not be read and must not be skipped.
        NumericalError
            When the solve gives numbers that are not finite or too large.
        """
        if not self.skips_bad_frames:
            block.raise_read_errors(ignore_missing=True)
        workspace = self._thread_local.__dict__.setdefault("workspace", Workspace())
        digests = tuple(map(self.sequence.digest_or_zeros, range(block.start, block.stop)))
        if self.capture is not None:
            with self.progress.stage("solve"):
                found = self.capture.solve_block(block, workspace)
            with self.progress.stage("measure"):
                return self.capture.measure_block(found, digests)
        with self.progress.stage("solve"):
            solution = self.solver.solve(block.positions, workspace)
        with self.progress.stage("measure"):
            rest, counted = self.solver.binding.rest, self.solver.data_vertices
            rebuilt = solution.reconstructions
            measured = measure(rest, block.positions, rebuilt, counted, workspace)
        check_finite(block.start, solution.cages, measured.metrics)
        return make_solved_block(block, solution, measured, digests)


class BlockExecutor(Protocol):
    """Solves the blocks of a clip, in threads or on a cluster."""

    def run_blocks(
        self, block_solver: BlockSolver, starts: range, memory_plan: MemoryPlan
    ) -> AbstractContextManager[Iterator[SolvedBlock]]:
        """Open an iterator of the blocks that begin at `starts`, in order, solved ahead."""


@dataclass(frozen=True, slots=True)
class ThreadExecutor:
    """Solves blocks in threads of this process, which also read frames ahead."""

    jobs: int

    @contextmanager
    def run_blocks(
        self, block_solver: BlockSolver, starts: range, memory_plan: MemoryPlan
    ) -> Iterator[Iterator[SolvedBlock]]:
        """Open an iterator of the blocks that begin at `starts`, in order."""
        frames = range(starts.start, starts.stop)
        with (
            FramePrefetcher(
                block_solver.sequence, self.jobs, memory_plan.max_queued_frames, frames
            ) as read,
            OrderedMap(
                block_solver.solve_block,
                _timed_reads(read.blocks(starts.step), block_solver.progress),
                memory_plan.max_parallel_blocks,
                memory_plan.max_parallel_blocks,
            ) as solved_blocks,
        ):
            yield solved_blocks


def _timed_reads(blocks: Iterator[Block], progress: ProgressListener) -> Iterator[Block]:
    """Yield blocks; the time of waiting for them counts as the stage `read`."""
    while True:
        with progress.stage("read"):
            block = next(blocks, None)
        if block is None:
            return
        yield block
