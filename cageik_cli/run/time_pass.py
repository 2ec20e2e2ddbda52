"""The second pass of a run: cages smoothed over time and filled, and measured again.

Before it, vertices that are occluded for long are placed by the surface around them, and their
frames are solved again. Those are the vertices whose place no motion around them in time tells (see
`captured.bridge`); the clip is read again for them, as the other vertices tell how the surface
around has moved.
"""

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from cageik_cli.captured.bridge import count_bridged_frames
from cageik_cli.captured.fill import FrameTerms, RigidFiller, TimeFiller
from cageik_cli.captured.frames import CapturedBlockSolver
from cageik_cli.captured.settings import AUTO_SMOOTHING, CaptureSettings
from cageik_cli.captured.smooth import TimeSmoother, choose_strengths
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.geometry.frames import Block
from cageik_cli.geometry.rotations import nearest_rotations_by_svd
from cageik_cli.method.solve.blocks import BlockSolver, SolvedBlock
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver, Solution
from cageik_cli.method.solve.summary import (
    DEFAULT_BRIDGED_FRAMES,
    OcclusionTracker,
    summarize_blocks,
)
from cageik_cli.method.weights.binding import Poses, reconstruct_frames
from cageik_cli.run.executor import choose_block_size
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.store.checkpoint import Checkpoint
from cageik_cli.store.result import placed_path, smoothed_path
from cageik_cli.util.arrays import Floats, Integers, Mask
from cageik_cli.util.errors import FileAccessError, InputError
from cageik_cli.util.messages import say

MAX_FILLED_GAP = 48
"""Frames of a gap that is filled, at most."""


@contextmanager
def open_refined(
    block_solver: BlockSolver[MeshSequence],
    checkpoint: Checkpoint,
    settings: ExtractSettings,
    fps: float,
) -> Iterator[tuple[Checkpoint, tuple[int, ...]]]:
    """Open a checkpoint with the frames as they are written, and say which of them were filled.

    Vertices that are occluded for long are placed, and the cages are smoothed and filled if that is
    asked for; otherwise it is the one that is given.
    """
    summary = checkpoint.summary
    filled: tuple[int, ...] = ()
    is_empty = len(summary.skipped) == len(block_solver.sequence)
    if is_empty or not isinstance(block_solver, CapturedBlockSolver):
        yield checkpoint, filled
        return
    with ExitStack() as stack:

        def start(find_path: Callable[[Path], Path]) -> Checkpoint:
            path = find_path(settings.output)
            copy = Checkpoint.open(path, checkpoint.spec, resume=False, overwrite=True)
            stack.callback(copy.discard)
            return copy

        bridged = DEFAULT_BRIDGED_FRAMES
        if settings.capture.smooth is not None:
            bridged = _count_bridged(block_solver.solver, checkpoint)
        summary.set_bridged(bridged)
        if summary.occlusions is not None and summary.occlusions.has_long:
            placed = start(placed_path)
            _place_occluded(block_solver, checkpoint, placed, settings.jobs)
            placed.summary.set_bridged(bridged)
            checkpoint = placed
        if settings.capture.needs_time_pass:
            smoothed = start(smoothed_path)
            filled = _run_time_pass(
                block_solver,
                checkpoint,
                smoothed,
                settings=settings.capture,
                fps=fps,
                jobs=settings.jobs,
            )
            smoothed.summary.set_bridged(bridged)
            checkpoint = smoothed
        yield checkpoint, filled


def _place_occluded(
    block_solver: CapturedBlockSolver[MeshSequence],
    checkpoint: Checkpoint,
    output: Checkpoint,
    jobs: int,
) -> None:
    """Place what is occluded for long in the frames of a checkpoint, and append them to another.

    Frames are read again by `jobs` threads.
    """
    progress, sequence = block_solver.progress, block_solver.sequence
    occlusions = checkpoint.summary.occlusions
    assert occlusions is not None
    filler = RigidFiller(block_solver.solver.binding.rest)
    reads = sequence.blocks(choose_block_size(checkpoint.spec.vertices), jobs)
    for solved, block in zip(checkpoint.blocks(), reads, strict=True):
        places = [
            frame - solved.start
            for frame in range(solved.start, solved.stop)
            if frame not in solved.skipped and len(occlusions.find_long(frame))
        ]
        if places:
            with progress.stage("solve"):
                cages = _solve_placed(block_solver, filler, solved, block, places)
            with progress.stage("measure"):
                solved = _measure_again(block_solver, solved, cages, block)
        output.append(solved)


def _solve_placed(
    block_solver: CapturedBlockSolver[MeshSequence],
    filler: RigidFiller,
    solved: SolvedBlock,
    block: Block,
    places: list[int],
) -> Floats:
    """Return the cages of a block, in whose frames at `places` all that is hidden is placed."""
    assert solved.kept is not None
    solver, cages = block_solver.solver, solved.cages.copy()
    positions, _ = block_solver.complete(block)
    # What is missing for a shorter time, rejected, or never data tells nothing of the surface.
    shares = solved.kept.expand_weights(positions.shape[1]) * (solver.vertex_weights > 0)
    for place in places:
        one, share = slice(place, place + 1), shares[place]
        rebuilt = reconstruct_frames(solver.binding, Poses(cages, solved.rotations)[one])[0]
        left, is_occluded = share[:, None] * (positions[place] - rebuilt), share == 0
        guess = filler.fill(rebuilt + filler.extend(left, is_occluded), is_occluded)
        # What the cage misses of the surface around the piece goes on into it.
        rebuilt = solver.solve(guess[None]).reconstructions[0].copy()
        guess = rebuilt + filler.extend(guess - rebuilt, is_occluded)
        cages[place] = solver.solve(guess[None]).cages[0]
    return cages


def _run_time_pass(
    block_solver: CapturedBlockSolver[MeshSequence],
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
    time_pass, filled = _TimePass(block_solver.solver, checkpoint, settings, fps), []
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
                    solved = _measure_again(block_solver, solved, smoothed.cages, block)
            output.append(_set_filled(block_solver.solver, solved, smoothed))
            filled += (np.flatnonzero(smoothed.is_filled) + smoothed.start).tolist()
    return tuple(filled)


class _HeldFrames:
    """Solved frames in memory, in the place of a checkpoint."""

    def __init__(self, blocks: Sequence[SolvedBlock]) -> None:
        self.summary, self._held = summarize_blocks(blocks), blocks

    def blocks(self) -> Iterator[SolvedBlock]:
        """Yield the blocks in order."""
        return iter(self._held)


def _count_bridged(solver: DualLaplacianSolver, frames: "Checkpoint | _HeldFrames") -> int:
    """Return for how many frames in a row motion tells where vertices of a clip are."""
    sampled, count = solver.sampled_vertices, frames.summary.frames_done
    found = count_bridged_frames(frames.blocks(), sampled, count)
    return DEFAULT_BRIDGED_FRAMES if found is None else found


def smooth_frames(
    solver: DualLaplacianSolver,
    blocks: Sequence[SolvedBlock],
    settings: CaptureSettings,
    fps: float,
) -> tuple[Poses, OcclusionTracker | None]:
    """Return the poses of the frames of captured blocks, smoothed and filled as a run does.

    Gaps that are not filled have nan. Beside them is what is occluded, and for how long.
    """
    held = _HeldFrames(blocks)
    held.summary.set_bridged(_count_bridged(solver, held))
    windows = _TimePass(solver, held, settings, fps).run()
    cages = np.concatenate([window.cages for window in windows])
    return Poses(cages, find_rotations(solver, np.nan_to_num(cages))), held.summary.occlusions


@dataclass(frozen=True, slots=True, eq=False)
class _SmoothedFrames:
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


class _TimePass:
    """Smooths and fills the cages that a checkpoint holds.

    Parameters
    ----------
    checkpoint : Checkpoint or _HeldFrames
        Of all frames, solved one by one.
    """

    def __init__(
        self,
        solver: DualLaplacianSolver,
        checkpoint: "Checkpoint | _HeldFrames",
        settings: CaptureSettings,
        fps: float,
    ) -> None:
        self._solver, self._checkpoint = solver, checkpoint
        self._settings, self._fps = settings, fps
        self._count = checkpoint.summary.frames_done
        self._filler, self._smoother = TimeFiller(solver), TimeSmoother(solver)
        self._is_known = np.ones(self._count, bool)
        self._is_known[list(checkpoint.summary.skipped)] = False

    def run(self) -> Iterator[_SmoothedFrames]:
        """Yield the frames of all windows, without their overlaps."""
        wanted = self._is_known | self._is_fillable
        for inner, cages in self._fill() if self.strengths is None else self._smooth():
            here = slice(inner.start, inner.stop)
            cages[~wanted[here]] = np.nan
            yield _SmoothedFrames(inner.start, cages, (wanted & ~self._is_known)[here])

    def _fill(self) -> Iterator[tuple[range, Floats]]:
        """Yield the frames of each window and their cages, with gaps filled."""
        for inner, window, terms in self._read_windows():
            filled = np.where(terms.is_known[:, None, None], terms.cages, self._fill_terms(terms))
            own = slice(inner.start - window.start, inner.stop - window.start)
            yield inner, _extend_to_ends(filled, terms.is_known)[own]

    def _fill_terms(self, terms: FrameTerms) -> Floats:
        """Return the cages of a window whose missing parts, and then whose gaps, are filled."""
        return self._smoother.fill(self._filler.fill(terms), terms.is_known)

    def _smooth(self) -> Iterator[tuple[range, Floats]]:
        """Yield the frames of each window and their cages, filled and smoothed.

        They overlap by more frames than those that are filled, of which all matrices are held.
        """
        strengths, n = self.strengths, len(self._solver.rest_cage)
        assert strengths is not None
        reach, windows = self._smoother.measure_reach(strengths), self._read_windows()
        start, cages, shares = 0, np.empty((0, n, 3)), np.empty((0, 2 + n))
        for inner in self._inner_frames:
            wide = self._overlap(inner, reach)
            while start + len(cages) < wide.stop:
                own, window, terms = next(windows)
                here = slice(own.start - window.start, own.stop - window.start)
                filled = _extend_to_ends(self._fill_terms(terms), terms.is_known)[here]
                cages = np.concatenate([cages, filled])
                shares = np.concatenate([shares, self._smoother.measure_shares(terms)[here]])
            cages, shares = cages[wide.start - start :], shares[wide.start - start :]
            start = wide.start
            smooth = self._smoother.smooth(cages[: len(wide)], shares[: len(wide)], strengths)
            smooth = _extend_to_ends(smooth, self._is_known[wide.start : wide.stop])
            yield inner, smooth[inner.start - wide.start : inner.stop - wide.start]

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
            own = slice(inner.start - window.start, inner.stop - window.start)
            known, filled = terms.is_known[own], self._fill_terms(terms)[own]
            if known.sum() >= 3:
                more, free = self._smoother.measure_validation(filled, known)
                taken, freedom, frames = taken + more, freedom + free, frames + int(known.sum())
        return choose_strengths(taken, freedom, frames) if frames else None

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

    @property
    def _inner_frames(self) -> list[range]:
        """Frames of all windows, without their overlaps."""
        size, count = self._smoother.window, self._count
        step = size - 2 * self._smoother.overlap if count > size else count
        return [range(start, min(start + step, count)) for start in range(0, count, step)]

    def _read_windows(self) -> Iterator[tuple[range, range, FrameTerms]]:
        """Yield the frames of each window without and with overlaps, and their terms."""
        occlusions = self._checkpoint.summary.occlusions
        assert occlusions is not None
        blocks, held = self._checkpoint.blocks(), _BufferedFrames(self._solver, occlusions)
        for inner in self._inner_frames:
            window = self._overlap(inner, self._smoother.overlap)
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


class _BufferedFrames:
    """Frames of a checkpoint that windows still need."""

    def __init__(self, solver: DualLaplacianSolver, occlusions: OcclusionTracker) -> None:
        self.stop = 0
        self._solver, self._occlusions = solver, occlusions
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
        for k, frame in enumerate(window):
            rows, values = self._weights.get(frame, nothing)
            is_lost = (values > 0) | ~np.isin(rows, self._occlusions.find_long(frame))
            if is_lost.any():
                rows, values = rows[is_lost], values[is_lost]
                weights = (1 - values) * self._solver.vertex_weights[rows]
                yield k, self._solver.weigh_data(weights, rows)


def _extend_to_ends(cages: Floats, is_known: Mask) -> Floats:
    """Return cages where frames before the first and behind the last known one are like that."""
    known = np.flatnonzero(is_known)
    if not len(known):
        return cages
    held = cages.copy()
    held[: known[0]], held[known[-1] + 1 :] = cages[known[0]], cages[known[-1]]
    return held


def _read_blocks(
    sequence: MeshSequence, size: int, jobs: int, is_needed: bool
) -> Generator[Block | None]:
    if not is_needed:
        while True:
            yield None
    yield from sequence.blocks(size, jobs)


def _cut_into_blocks(
    windows: Iterator[_SmoothedFrames], size: int, count: int
) -> Iterator[_SmoothedFrames]:
    """Yield the frames of windows in blocks of `size`."""
    cages, is_filled, start = np.empty((0, 0, 3)), np.empty(0, bool), 0
    for window in windows:
        cages = np.concatenate([cages, window.cages]) if len(cages) else window.cages
        is_filled = np.concatenate([is_filled, window.is_filled])
        while len(cages) >= size or (len(cages) and start + len(cages) == count):
            yield _SmoothedFrames(start, cages[:size], is_filled[:size])
            start += len(cages[:size])
            cages, is_filled = cages[size:], is_filled[size:]


def _set_filled(
    solver: DualLaplacianSolver, solved: SolvedBlock, smoothed: _SmoothedFrames
) -> SolvedBlock:
    """Return a block with the cages of the gaps that were filled."""
    if not smoothed.is_filled.any():
        return solved
    cages, rotations = solved.cages.copy(), solved.rotations.copy()
    cages[smoothed.is_filled] = smoothed.cages[smoothed.is_filled]
    rotations[smoothed.is_filled] = find_rotations(solver, cages[smoothed.is_filled])
    return replace(solved, cages=cages, rotations=rotations)


def find_rotations(solver: DualLaplacianSolver, cages: Floats) -> Floats:
    """Return the rotations (k, 3, 3) of the rest pose to the meshes of cages (k, n, 3)."""
    if not solver.is_aligned:
        return np.tile(np.eye(3), (len(cages), 1, 1))
    weighted = solver.vertex_weights[:, None] * solver.rest
    # The mesh relative to any point will do, as the weighted rest pose sums to zero.
    moments = (solver.binding.weights.T @ weighted).T
    turns = nearest_rotations_by_svd(moments @ np.concatenate([solver.rest_cage[None], cages]))
    # Weights with offsets turn the rest cage, too; without, this is the identity.
    return np.asarray(turns[0].T @ turns[1:])


def _measure_again(
    block_solver: CapturedBlockSolver[MeshSequence],
    solved: SolvedBlock,
    cages: Floats,
    block: Block | None,
) -> SolvedBlock:
    """Return a block with other cages, (k, n, 3), and what they leave of its residuals."""
    assert block is not None
    assert solved.kept is not None
    sequence, solver = block_solver.sequence, block_solver.solver
    binding = solver.binding
    _check_unchanged(sequence, solved)
    skipped = np.array(sorted(solved.skipped), np.int64) - solved.start
    cages = cages.copy()
    cages[skipped] = binding.cage.vertices
    rotations = find_rotations(solver, cages)
    rebuilt = reconstruct_frames(binding, Poses(cages, rotations))
    positions, given = block_solver.complete(block)
    weights = solved.kept.expand_weights(rebuilt.shape[1])
    solution = Solution(cages, rotations, rebuilt, solved.sampled, weights)
    errors: dict[int, InputError] = {
        k: FileAccessError(reason) for k, reason in solved.skipped.items()
    }
    again = replace(block, positions=positions, read_errors=errors)
    return block_solver.measure_block(again, given, solution, solved.digests)


def _check_unchanged(sequence: MeshSequence, solved: SolvedBlock) -> None:
    """Refuse frames that are not those that were solved.

    Raises
    ------
    InputError
        Naming the frame.
    """
    for k, digest in enumerate(solved.digests, solved.start):
        if sequence.digest_or_zeros(k) != digest:
            raise FileAccessError(
                f"{sequence.location(k)}: changed during the run; "
                + say("run again with `resume=True`")
            )
