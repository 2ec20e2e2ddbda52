"""The second pass of a run: cages smoothed over time and filled, and measured again."""

from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from cageik_cli.coordinates.binding import reconstruct_frames
from cageik_cli.formats.base.sequence import Block, MeshSequence
from cageik_cli.geometry.rotations import nearest_rotations_by_svd
from cageik_cli.solver.blocks import BlockSolver, SolvedBlock
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver, Solution
from cageik_cli.solver.executor import choose_block_size
from cageik_cli.solver.fill import MAX_BRIDGED_FRAMES, FrameTerms, TimeFiller
from cageik_cli.solver.settings import AUTO_SMOOTHING, CaptureSettings
from cageik_cli.solver.smooth import TimeSmoother, choose_strengths
from cageik_cli.store.checkpoint import Checkpoint
from cageik_cli.util.arrays import Floats, Integers, Mask
from cageik_cli.util.errors import FileAccessError, InputError

MAX_FILLED_GAP = 48
"""Frames of a gap that is filled, at most."""


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedFrames:
    """The cages of all frames, in order, by blocks.

    Attributes
    ----------
    start : int
        Number of the first frame.
    cages : (k, n, 3) float64
        nan for gaps that stay.
    is_filled : (k,) bool
    """

    start: int
    cages: Floats
    is_filled: Mask


class TimePass:
    """Smooths and fills the cages that a checkpoint holds.

    Parameters
    ----------
    checkpoint : Checkpoint
        Of all frames, solved one by one.
    """

    def __init__(
        self,
        solver: DualLaplacianSolver,
        checkpoint: Checkpoint,
        settings: CaptureSettings,
        fps: float,
    ) -> None:
        self._solver, self._checkpoint = solver, checkpoint
        self._settings, self._fps = settings, fps
        self._count = len(checkpoint.spec.frames)
        self._filler, self._smoother = TimeFiller(solver), TimeSmoother(solver)
        self._is_known = np.ones(self._count, bool)
        self._is_known[list(checkpoint.summary.skipped)] = False

    def run(self) -> Iterator[SmoothedFrames]:
        """Yield the frames of all windows, without their overlaps."""
        strengths, wanted = self.strengths, self._is_known | self._is_fillable
        for inner, window, terms in self._read_windows():
            filled = self._filler.fill(terms)
            if strengths is None:
                smooth = np.where(terms.is_known[:, None, None], terms.cages, filled)
            else:
                smooth = self._smoother.smooth(filled, terms, strengths)
            smooth = _hold_ends(smooth, terms.is_known)
            own = slice(inner.start - window.start, inner.stop - window.start)
            cages, here = smooth[own].copy(), slice(inner.start, inner.stop)
            cages[~wanted[here]] = np.nan
            yield SmoothedFrames(inner.start, cages, (wanted & ~self._is_known)[here])

    @cached_property
    def strengths(self) -> Floats | None:
        """Strengths of smoothing, as of `TimeSmoother`; None if frames are only filled."""
        chosen = self._settings.smooth
        if chosen is None or self._is_known.sum() < 3:
            return None
        if chosen != AUTO_SMOOTHING:
            return self._smoother.repeat_period(float(chosen) * self._fps)
        taken, freedom, frames = np.zeros(1), np.zeros(1), 0
        for inner, window, terms in self._read_windows():
            if len(inner) >= 3:
                own = slice(inner.start - window.start, inner.stop - window.start)
                more, free = self._smoother.measure_validation(self._filler.fill(terms)[own])
                taken, freedom, frames = taken + more, freedom + free, frames + len(inner)
        return choose_strengths(taken, freedom, frames)

    @cached_property
    def _is_fillable(self) -> Mask:
        """Which gaps are short enough to be filled, (F,)."""
        if not self._settings.fill_gaps:
            return np.zeros(self._count, bool)
        edges = np.flatnonzero(np.diff(np.concatenate([[True], self._is_known, [True]])))
        is_short = np.zeros(self._count, bool)
        for start, stop in edges.reshape(-1, 2):
            is_short[start:stop] = stop - start <= MAX_FILLED_GAP
        return is_short

    def _read_windows(self) -> Iterator[tuple[range, range, FrameTerms]]:
        """Yield the frames of each window without and with overlaps, and their terms."""
        size, overlap = self._smoother.window, self._smoother.overlap
        blocks, held = self._checkpoint.blocks(), _HeldBlocks(self._solver)
        step = size - 2 * overlap if self._count > size else self._count
        for start in range(0, self._count, step):
            inner = range(start, min(start + step, self._count))
            window = self._overlap(inner, overlap)
            while held.stop < window.stop:
                held.add(next(blocks))
            held.drop(window.start)
            yield inner, window, held.make_terms(window, self._is_known)

    def _overlap(self, inner: range, overlap: int) -> range:
        """Return frames with so many more at both ends, beside those of gaps that are filled.

        A gap at an end would otherwise have its cages from one side only.
        """
        counted = np.flatnonzero(self._is_known | ~self._is_fillable)
        first, behind = np.searchsorted(counted, [inner.start, inner.stop])
        start = counted[first - overlap] if first > overlap else 0
        stop = counted[behind + overlap - 1] + 1 if behind + overlap < len(counted) else self._count
        return range(int(start), int(stop))


class _HeldBlocks:
    """Frames of a checkpoint that windows still need."""

    def __init__(self, solver: DualLaplacianSolver) -> None:
        self.stop = 0
        self._solver = solver
        self._cages: dict[int, Floats] = {}
        self._weights: dict[int, tuple[Integers, Floats]] = {}

    def add(self, block: SolvedBlock) -> None:
        """Hold the frames of the next block."""
        for place in range(len(block.cages)):
            frame = block.start + place
            self._cages[frame] = block.cages[place]
            if block.kept is not None:
                self._weights[frame] = block.kept.get_weights(place)
        self.stop = block.stop

    def drop(self, start: int) -> None:
        """Forget the frames before `start`."""
        for held in (self._cages, self._weights):
            for frame in [frame for frame in held if frame < start]:
                del held[frame]

    def make_terms(self, window: range, is_known: Mask) -> FrameTerms:
        """Return the terms of the frames of a window; frames without data have zeros."""
        known = is_known[window.start : window.stop]
        cages = np.nan_to_num(np.stack([self._cages[k] for k in window]))
        return FrameTerms(cages, known, dict(self._find_lost(window)))

    def _find_lost(self, window: range) -> Iterator[tuple[int, Floats]]:
        """Yield the frames, counted in the window, in which vertices weigh less, and their E_t."""
        nothing = np.empty(0, np.int64), np.empty(0)
        frames = [self._weights.get(k, nothing) for k in window]
        lengths = count_in_a_row([rows[values == 0] for rows, values in frames])
        for k, ((rows, values), length) in enumerate(zip(frames, lengths, strict=True)):
            is_lost = np.ones(len(rows), bool)
            is_lost[values == 0] = length <= MAX_BRIDGED_FRAMES
            if is_lost.any():
                rows, values = rows[is_lost], values[is_lost]
                weights = (1 - values) * self._solver.vertex_weights[rows]
                yield k, self._solver.weigh_data(weights, rows)


def count_in_a_row(frames: Sequence[Integers]) -> list[Integers]:
    """Return for the elements (e,) of each frame in how many frames in a row around it they are."""
    lengths = [np.full(len(elements), -1) for elements in frames]
    count = 1 + max((int(elements.max(initial=-1)) for elements in frames), default=-1)
    for places in (range(len(frames)), reversed(range(len(frames)))):
        row = np.zeros(count, np.int64)
        for k in places:
            before, row = row, np.zeros(count, np.int64)
            row[frames[k]] = before[frames[k]] + 1
            lengths[k] += row[frames[k]]
    return lengths


def _hold_ends(cages: Floats, is_known: Mask) -> Floats:
    """Return cages where frames before the first and behind the last known one are like that."""
    known = np.flatnonzero(is_known)
    if not len(known):
        return cages
    held = cages.copy()
    held[: known[0]], held[known[-1] + 1 :] = cages[known[0]], cages[known[-1]]
    return held


def find_rotations(solver: DualLaplacianSolver, cages: Floats) -> Floats:
    """Return the rotations (k, 3, 3) of the rest pose to the meshes of cages (k, n, 3)."""
    if not solver.is_aligned:
        return np.tile(np.eye(3), (len(cages), 1, 1))
    weighted = solver.vertex_weights[:, None] * solver.rest
    # The mesh relative to any point will do, as the weighted rest pose sums to zero.
    return nearest_rotations_by_svd((solver.binding.weights.T @ weighted).T @ cages)


def run_time_pass(
    block_solver: BlockSolver,
    checkpoint: Checkpoint,
    output: Checkpoint,
    *,
    settings: CaptureSettings,
    fps: float,
    jobs: int,
) -> tuple[int, ...]:
    """Smooth and fill the frames of a checkpoint, and append them to another.

    Frames are read again, by `jobs` threads, where their figures change.

    Returns
    -------
    tuple of int
        The frames that were filled.
    """
    progress, sequence = block_solver.progress, block_solver.sequence
    time_pass, filled = TimePass(block_solver.solver, checkpoint, settings, fps), []
    size = choose_block_size(checkpoint.spec.vertices)
    frames = _cut_into_blocks(time_pass.run(), size, len(sequence))
    with progress.stage("smooth"):
        is_smoothed = time_pass.strengths is not None
    with closing(_read_blocks(sequence, size, jobs, is_needed=is_smoothed)) as reads:
        for solved in checkpoint.blocks():
            with progress.stage("smooth"):
                smoothed = next(frames)
            with progress.stage("read"):
                block = next(reads)
            if is_smoothed:
                with progress.stage("measure"):
                    solved = _measure_again(block_solver, solved, smoothed, block)
            output.append(_set_filled(block_solver.solver, solved, smoothed))
            filled += (np.flatnonzero(smoothed.is_filled) + smoothed.start).tolist()
    return tuple(filled)


def _read_blocks(
    sequence: MeshSequence, size: int, jobs: int, is_needed: bool
) -> Generator[Block | None]:
    if not is_needed:
        while True:
            yield None
    yield from sequence.blocks(size, jobs)


def _cut_into_blocks(
    windows: Iterator[SmoothedFrames], size: int, count: int
) -> Iterator[SmoothedFrames]:
    """Yield the frames of windows in blocks of `size`."""
    cages, is_filled, start = np.empty((0, 0, 3)), np.empty(0, bool), 0
    for window in windows:
        cages = np.concatenate([cages, window.cages]) if len(cages) else window.cages
        is_filled = np.concatenate([is_filled, window.is_filled])
        while len(cages) >= size or (len(cages) and start + len(cages) == count):
            yield SmoothedFrames(start, cages[:size], is_filled[:size])
            start += len(cages[:size])
            cages, is_filled = cages[size:], is_filled[size:]


def _measure_again(
    block_solver: BlockSolver,
    solved: SolvedBlock,
    smoothed: SmoothedFrames,
    block: Block | None,
) -> SolvedBlock:
    """Return a block with smoothed cages, and what is left of its residuals."""
    assert block is not None
    assert solved.kept is not None
    sequence, solver = block_solver.sequence, block_solver.solver
    binding = solver.binding
    for k, digest in enumerate(solved.digests, solved.start):
        if sequence.digest_or_zeros(k) != digest:
            raise FileAccessError(
                f"{sequence.location(k)}: changed during the run; run again with `resume=True`"
            )
    skipped = np.array(sorted(solved.skipped), np.int64) - solved.start
    cages = smoothed.cages.copy()
    cages[skipped] = binding.cage.vertices
    rotations = find_rotations(solver, cages)
    rebuilt = reconstruct_frames(binding, cages, rotations)
    positions, given = block_solver.complete(block)
    weights = solved.kept.expand_weights(rebuilt.shape[1])
    solution = Solution(cages, rebuilt, rotations, solved.sampled, weights)
    errors: dict[int, InputError] = {
        k: FileAccessError(reason) for k, reason in solved.skipped.items()
    }
    again = replace(block, positions=positions, read_errors=errors)
    return block_solver.measure_block(again, given, solution, solved.digests)


def _set_filled(
    solver: DualLaplacianSolver, solved: SolvedBlock, smoothed: SmoothedFrames
) -> SolvedBlock:
    """Return a block with the cages of the gaps that were filled."""
    if not smoothed.is_filled.any():
        return solved
    cages, rotations = solved.cages.copy(), solved.rotations.copy()
    cages[smoothed.is_filled] = smoothed.cages[smoothed.is_filled]
    rotations[smoothed.is_filled] = find_rotations(solver, cages[smoothed.is_filled])
    return replace(solved, cages=cages, rotations=rotations)
