"""The frames of a clip in blocks: solved, and measured.

Frames whose vertices do not count alike, as in captured clips, are solved by a subclass.
"""

import threading
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from cageik_cli.geometry.frames import Block, FrameSource
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver, Solution
from cageik_cli.method.solve.metrics import (
    DeviationPeaks,
    FrameMetrics,
    KeptMetrics,
    check_finite,
    leave_gaps,
    map_columns,
    measure,
)
from cageik_cli.method.weights.binding import Poses
from cageik_cli.util.arrays import Floats, Integers, Mask, Workspace
from cageik_cli.util.messages import Said, map_words
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import to_unicode

Clip = TypeVar("Clip", bound=FrameSource)
"""What the frames are read from."""


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


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SolvedBlock(Poses):
    """Consecutive frames, solved and measured; cages and rotations of skipped ones are nan.

    Attributes
    ----------
    start : int
        Number of the first frame.
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

    rotations: Floats
    start: int
    metrics: FrameMetrics
    squared_errors: Floats
    peaks: DeviationPeaks
    digests: tuple[bytes, ...]
    skipped: dict[int, Said]
    sampled: NDArray[np.float32]
    kept: KeptBlock | None = None

    @property
    def stop(self) -> int:
        """Return the number of the frame after the last."""
        return self.start + len(self)


class BlockSolver(Generic[Clip]):
    """Solver and measurement of the blocks of a clip whose vertices count alike in all frames.

    Parameters
    ----------
    skips_bad_frames : bool
        Whether frames that cannot be read become gaps, as missing ones do; otherwise they are
        refused.

    All parameters are attributes too.
    """

    def __init__(
        self,
        sequence: Clip,
        solver: DualLaplacianSolver,
        progress: ProgressListener,
        *,
        skips_bad_frames: bool = False,
    ) -> None:
        self.sequence, self.solver, self.progress = sequence, solver, progress
        self.skips_bad_frames = skips_bad_frames
        self._thread_local = threading.local()

    def solve_block(self, block: Block) -> SolvedBlock:
        """Solve and measure a block.

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
        return self._solve_and_measure(block, digests)

    def _solve_and_measure(self, block: Block, digests: tuple[bytes, ...]) -> SolvedBlock:
        """Solve and measure a block, whose frames that could not be read are gaps."""
        solver = self.solver
        with self.progress.stage("solve"):
            solution = solver.solve(block.positions, self._workspace)
        with self.progress.stage("measure"):
            metrics, squares = measure(
                solver.binding.rest,
                block.positions,
                solution.reconstructions,
                solver.data_vertices,
                self._workspace,
            )
            return make_solved_block(block, solution, metrics, squares, digests)

    @property
    def _workspace(self) -> Workspace:
        """Memory of this thread."""
        found: Workspace = self._thread_local.__dict__.setdefault("workspace", Workspace())
        return found


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
    gaps = block.gaps
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
        skipped={k: map_words(to_unicode, one.text) for k, one in block.read_errors.items()},
        sampled=sampled,
        kept=kept,
    )
