"""Blocks of captured frames: completed, solved by weights, and measured over what was kept."""

from dataclasses import dataclass, replace

import numpy as np

from cageik_cli.formats.base.sequence import Block
from cageik_cli.solver.blocks import SolvedBlock, make_solved_block
from cageik_cli.solver.captured import CapturedFrames, FrameWeights, complete_frames
from cageik_cli.solver.dual_laplacian import Solution
from cageik_cli.solver.kept import KeptBlock, SparseWeights, measure_noise
from cageik_cli.solver.metrics import (
    KEPT_TYPES,
    METRIC_TYPES,
    FrameMetrics,
    KeptErrors,
    KeptMetrics,
    check_finite,
    measure_kept,
)
from cageik_cli.solver.robust import MAX_REJECTED_WEIGHT, RobustSolver, WeighedSolution
from cageik_cli.util.arrays import Floats, Integers, Mask, Workspace
from cageik_cli.util.errors import FormatError, InputError


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredBlock:
    """Errors of a block, which vertices were kept (k, m), their weights (k, m), and noise (k,)."""

    errors: KeptErrors
    is_kept: Mask
    weights: Floats
    noise: Floats


@dataclass(frozen=True, slots=True, eq=False)
class SolvedFrames:
    """A block, its completed frames, their solution, and weights (k, m) if not all are 1."""

    block: Block
    captured: CapturedFrames
    solution: Solution
    weights: Floats | None


@dataclass(frozen=True, slots=True, eq=False)
class CapturedBlockSolver:
    """Solver of blocks of captured frames.

    Attributes
    ----------
    frame_weights : FrameWeights, optional
        Of each frame of the clip.
    names : tuple of str
        Of the frames, for messages.
    accepts_gaps : bool
        Whether frames of too few data become gaps; otherwise they are refused.
    """

    robust: RobustSolver
    frame_weights: FrameWeights | None
    names: tuple[str, ...]
    accepts_gaps: bool

    def read_weights(self, start: int, stop: int) -> Floats | None:
        """Read the weights of frames, (k, m), if there are any."""
        return None if self.frame_weights is None else self.frame_weights.read(start, stop)

    def complete(self, block: Block) -> CapturedFrames:
        """Return the frames of a block with a position for every vertex."""
        given = self.read_weights(block.start, block.stop)
        return complete_frames(self.robust.solver, block.positions, given)

    def solve_block(self, block: Block, workspace: Workspace) -> "SolvedFrames":
        """Solve a block; frames of too few data become gaps.

        Raises
        ------
        InputError
            Naming a frame of too few data, when it must not become a gap.
        """
        captured = self.complete(block)
        found = self.robust.solve(captured.positions, captured.weights, workspace)
        block = self._skip_thin_frames(block, captured, found)
        return SolvedFrames(block, captured, found.solution, found.weights)

    def measure_block(self, found: "SolvedFrames", digests: tuple[bytes, ...]) -> SolvedBlock:
        """Measure a block that was solved.

        Raises
        ------
        NumericalError
            When the solve gave numbers that are not finite or too large.
        """
        rebuilt = found.solution.reconstructions
        measured = self._measure(rebuilt, found.captured, found.weights)
        return make_kept_block(found.block, found.solution, measured, digests)

    def _measure(
        self, rebuilt: Floats, captured: CapturedFrames, weights: Floats | None
    ) -> "MeasuredBlock":
        """Measure reconstructions over data, and over what was kept by weights (k, m)."""
        is_data = self._find_data(captured)
        weights = np.ones(is_data.shape) if weights is None else weights
        is_kept = is_data
        if self.robust.tolerances is not None:
            # A small weight that is given is no outlier: only what is taken from it counts.
            given = 1.0 if captured.weights is None else captured.weights
            is_kept = is_data & (weights >= MAX_REJECTED_WEIGHT * given)
        rest = self.robust.solver.binding.rest
        errors = measure_kept(rest, captured.positions, rebuilt, is_data, is_kept)
        noise = measure_noise(rebuilt - captured.positions, is_kept)
        return MeasuredBlock(errors, is_kept, weights, noise)

    def _find_data(self, captured: CapturedFrames) -> Mask:
        """Return which vertices of each frame are data, (k, m)."""
        shape = captured.positions.shape[:2]
        is_data = np.broadcast_to(self.robust.solver.vertex_weights > 0, shape)
        return is_data if captured.weights is None else is_data & (captured.weights > 0)

    def _skip_thin_frames(
        self, block: Block, captured: CapturedFrames, found: WeighedSolution
    ) -> Block:
        """Return the block with an error for each frame of too few data."""
        errors: dict[int, InputError] = {}
        least = found.solution.cages.shape[1]
        counts = self._find_data(captured).sum(axis=1)
        for place, count in enumerate(counts):
            fault = found.faults.get(place)
            if count >= least and fault is None:
                continue
            reason = fault or f"fewer than the {least} vertices of the cage"
            errors[block.start + place] = FormatError(
                f"{self.names[block.start + place]}: {count} of {captured.positions.shape[1]} "
                f"vertices are data ({reason})"
            )
        errors = {k: error for k, error in errors.items() if k not in block.read_errors}
        if errors and not self.accepts_gaps:
            raise FormatError(
                f"{errors[min(errors)]}; leave a gap by --on-bad-frame skip, or fill it by "
                "--fill-gaps"
            )
        return replace(block, read_errors=block.read_errors | errors)


def make_kept_block(
    block: Block, solution: Solution, measured: MeasuredBlock, digests: tuple[bytes, ...]
) -> SolvedBlock:
    """Return the solved block with what was kept; frames that could not be read are gaps.

    Raises
    ------
    NumericalError
        When cages or metrics are not finite or too large.
    """
    gaps = np.array(sorted(block.read_errors), np.int64) - block.start
    known = np.setdiff1d(np.arange(len(solution.cages)), gaps)
    errors, metrics = measured.errors.errors, measured.errors.metrics
    whole = make_solved_block(block, solution, errors, digests)
    check_finite(block.start, whole.cages[known], select_frames(whole.metrics, known))
    columns = {name: getattr(metrics, name).copy() for name in KEPT_TYPES}
    for name, column in columns.items():
        column[gaps] = -1 if KEPT_TYPES[name] == "i8" else np.nan
    weights = measured.weights.copy()
    weights[gaps] = 1
    kept = KeptBlock(
        metrics=KeptMetrics(**columns),
        weights=SparseWeights.of(weights),
        counts=measured.is_kept[known].sum(axis=0),
        noise=_forget_beside(measured.noise, gaps),
    )
    squares = np.nan_to_num(errors.squared_errors[known])
    return replace(whole, squared_errors=squares.sum(axis=0), kept=kept)


def _forget_beside(noise: Floats, gaps: Integers) -> Floats:
    """Return noise without that of gaps, and of the frames beside them."""
    found = noise.copy()
    for step in (-1, 0, 1):
        places = gaps + step
        found[places[(places >= 0) & (places < len(found))]] = np.nan
    return found


def select_frames(metrics: FrameMetrics, places: Integers) -> FrameMetrics:
    """Return the metrics of the frames at `places`."""
    return FrameMetrics(**{name: getattr(metrics, name)[places] for name in METRIC_TYPES})
