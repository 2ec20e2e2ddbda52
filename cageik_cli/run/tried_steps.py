"""Try steps that may lower the error of a clip on some of its frames, before one is advised.

A step that is advised must not make a clip worse. So it is tried on the clip at hand, and the error
is compared with that of the run. For 10 000 vertices and a cage of 120, a fit takes 0.3 s of
processor time, and where the input has outliers, their rejection 1.5 s. Frames, and so the figures,
do not depend on the number of threads.

- Cages are smoothed by the strength that is found, where data is missing or a period is stated.
  Data that is there is hidden on purpose, and the error is that of what was hidden. It also tells
  how far off missing data may be, for which no other figure does.
- A fit is made to every second of the frames, in few rounds, and measured on the others.
- Outliers are rejected where the input has some, whatever the reconstruction misses: rejecting what
  the cage cannot follow would make it follow less. Errors are measured to where the neighbours tell
  that outliers should be. A fit alone would follow them; it is tried with their rejection.
- The same where pieces of the surface jump by themselves; nothing tells where these should be, so
  errors are measured of what is kept, and no fit is tried, which would follow them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from cageik_cli.captured.frames import CapturedBlockSolver, complete_frames, measure_tolerances
from cageik_cli.captured.robust import (
    RobustSolver,
    average_neighbours,
    find_outlier_vertices,
    is_often_torn,
)
from cageik_cli.captured.settings import AUTO_SMOOTHING, CaptureSettings
from cageik_cli.fit.settings import DEFAULT_STRENGTH, FitSettings
from cageik_cli.formats.base.sequence import MeshSequence, as_sequence
from cageik_cli.geometry.frames import Block
from cageik_cli.inputs.clip import VertexWeights
from cageik_cli.method.solve.blocks import BlockSolver, SolvedBlock
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver, Solution
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.solve.summary import ClipSummary
from cageik_cli.method.weights.binding import Binding, reconstruct_frames
from cageik_cli.report.notes import is_invisible
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.run.time_pass import smooth_frames
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.tried_steps import HiddenErrors, Step, TriedStep
from cageik_cli.util.arrays import Floats, Integers, Mask, count_frames, spread_evenly
from cageik_cli.util.errors import CageError, FormatError, InputError
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.threads import limit_blas_threads

MAX_TRIED_FRAMES = 24
"""Frames that a step is tried on: the half of them, or all, are evenly spread over the clip."""

MIN_SMOOTHED_FRAMES, MAX_SMOOTHED_FRAMES = 8, 32
"""Frames in a row that smoothing is tried on: in the middle of the longest row without a gap."""

MAX_REJECTED_FRAMES = 8
"""Frames in which outliers are rejected, which takes as long as to solve tens of others: half of
them are those with most outliers."""

FREE_MEMORY = 1 << 26
"""Bytes that a fit which is tried may take however small the limit is; so small models have it."""

FIT_SETTINGS = FitSettings(regularization=DEFAULT_STRENGTH.regularization)
"""Of a fit that is tried: strong, as of few frames; more frames are fitted more closely."""

FIT_ROUNDS = 3
"""Rounds of a fit that is tried; more lower the error of frames kept aside by some percent."""


class StepTrials:
    """Tries steps on some frames of a clip that is solved.

    Parameters
    ----------
    settings : ExtractSettings
        Of the run, with the norm that was chosen.
    stored : StoredBinding
        The weights of the run.
    summary : ClipSummary
        Of all frames.
    takes_fit : bool
        Whether the same run can be made with weights fitted to the clip.
    rejects_outliers : bool
        Whether the same run can be made with outliers rejected.
    """

    def __init__(
        self,
        settings: ExtractSettings,
        block_solver: BlockSolver[MeshSequence],
        stored: StoredBinding,
        summary: ClipSummary,
        vertex_weights: VertexWeights,
        *,
        fps: float,
        takes_fit: bool,
        rejects_outliers: bool,
    ) -> None:
        self._settings, self._block_solver, self._stored = settings, block_solver, stored
        self._binding, self._sequence = stored.binding, block_solver.sequence
        self._summary, self._vertex_weights = summary, vertex_weights
        self.hidden: HiddenErrors | None = None
        self._fps = fps
        self._takes_fit, self._rejects_outliers = takes_fit, rejects_outliers
        self._frame_count = summary.frames_done
        self._known = np.setdiff1d(np.arange(self._frame_count), list(summary.skipped))

    def run(self) -> tuple[TriedStep, ...]:
        """Try what may be advised, and measure what it gains; nothing where no error is seen."""
        if isinstance(self._block_solver, CapturedBlockSolver):
            with limit_blas_threads(1):
                tried = tuple(self._try_smoothing(self._block_solver))
            if any(one.has_helped for one in tried):
                return tried
        percent = 100 / self._binding.rest.diagonal
        rms = percent * float(np.sqrt(np.nanmean(self._summary.frame_rms**2)))
        if is_invisible(rms, percent * float(self._summary.peaks.deviations.max())):
            return ()
        spread = self._known[spread_evenly(len(self._known), MAX_TRIED_FRAMES)].tolist()
        with limit_blas_threads(1):
            outliers = self._find_outliers(spread)
            if any(is_outlier.any() for is_outlier in outliers.values()):
                return tuple(self._try_robust(spread, outliers))
            if self._is_torn(spread):
                return tuple(self._try_robust(spread, outliers, is_torn=True))
            return tuple(self._try_fit(spread))

    def _is_torn(self, spread: Sequence[int]) -> bool:
        """Return whether pieces of the input jump from frames to those after them."""
        read, known = self._sequence.read_frame, set(self._known.tolist())
        pairs = ((read(k), read(k + 1)) for k in spread if k + 1 in known)
        return is_often_torn(self._binding.rest, pairs)

    def _find_outliers(self, spread: Sequence[int]) -> dict[int, Mask]:
        """Find the outliers of the input, (m,), in some frames, and where vertices deviate most.

        The frames with most of them come first.
        """
        peaks = self._summary.peaks
        is_off = peaks.frames >= 0
        sizes = np.bincount(peaks.frames[is_off], peaks.deviations[is_off], self._frame_count)
        worst = np.argsort(-sizes, kind="stable")[: MAX_TRIED_FRAMES // 2]
        frames = sorted({*spread, *np.intersect1d(worst, self._known).tolist()})
        rest, read = self._binding.rest, self._sequence.read_frame
        found = {k: find_outlier_vertices(rest, read(k)) for k in frames}
        return dict(sorted(found.items(), key=lambda item: -item[1].sum()))

    def _try_smoothing(self, solver: CapturedBlockSolver[MeshSequence]) -> Iterator[TriedStep]:
        """Smooth frames with the strength that is found, in place of none or a stated one.

        It is measured where data is hidden on purpose: as in other frames, if any is missing; else
        all of each fourth frame.
        """
        chosen, (m, _) = self._settings.capture.smooth, self._binding.weights.shape
        runs = np.split(self._known, np.flatnonzero(np.diff(self._known) > 1) + 1)
        longest = max(runs, key=len)
        memory = max(self._settings.memory, FREE_MEMORY)
        most = min(MAX_SMOOTHED_FRAMES, count_frames(memory, m, arrays=6))
        frames = longest[max(0, (len(longest) - most) // 2) :][:most]
        if len(frames) < MIN_SMOOTHED_FRAMES:
            return
        seen = np.stack([self._sequence.read_frame(int(k)) for k in frames])
        is_missing = np.isnan(seen[..., 0])
        is_hidden = np.zeros_like(is_missing)
        if is_missing.any():
            is_hidden = self._hide_elsewhere(frames, is_missing)
        has_missing = bool(is_hidden.any())
        if not has_missing:
            if not isinstance(chosen, float | int):
                return
            is_hidden[2:-2:4] = ~is_missing[2:-2:4]
        blocks = self._solve_hidden(solver, frames, seen, is_hidden)
        is_hidden &= solver.solver.vertex_weights > 0
        for positions, hidden in zip(seen, is_hidden, strict=True):
            hidden &= ~find_outlier_vertices(self._binding.rest, positions)
        share = float(is_missing.mean()) if has_missing else 1.0
        tried: list[float | Literal["auto"] | None] = [chosen]
        tried += [] if chosen == AUTO_SMOOTHING else [AUTO_SMOOTHING]
        found = [self._measure_hidden(blocks, seen, is_hidden, one) for one in tried]
        measured = [one for one in found if one is not None]
        if has_missing and measured:
            self.hidden = measured[0][0]
        # What is seen counts, too, which smoothing may take away.
        totals = [
            float(np.sqrt(share * hidden.rms_percent**2 + (1 - share) * rms**2))
            for hidden, rms in measured
        ]
        if len(totals) == 2:
            yield TriedStep(Step.SMOOTH, totals[0], totals[1], measured[0][0].frames)

    def _hide_elsewhere(self, frames: Integers, is_missing: Mask) -> Mask:
        """Choose what to hide in frames, (k, m), as other frames of the clip have it missing.

        Those frames are so many later that both pieces overlap or touch least: one larger piece
        would say nothing of the smaller one. Where they do, nothing is hidden.
        """
        first, second = self._binding.rest.edges.ends.T
        count, best = len(self._known), np.zeros_like(is_missing)
        places = np.searchsorted(self._known, frames)
        for eighth in range(1, 8):
            later = self._known[(places + max(1, count * eighth // 8)) % count]
            hidden = np.stack([np.isnan(self._sequence.read_frame(int(k))[:, 0]) for k in later])
            is_apart = ~(is_missing & hidden).any(axis=1)
            for one, other in ((first, second), (second, first)):
                is_apart &= ~(is_missing[:, one] & hidden[:, other]).any(axis=1)
            hidden[~is_apart] = False
            best = hidden if hidden.sum() > best.sum() else best
        return best

    def _solve_hidden(
        self,
        solver: CapturedBlockSolver[MeshSequence],
        frames: Integers,
        seen: Floats,
        is_hidden: Mask,
    ) -> list[SolvedBlock]:
        """Solve frames, (k, m, 3), of which some vertices, (k, m), are hidden; or all: a gap."""
        weights, blocks = self._vertex_weights.frames, []
        for k, (positions, hidden) in enumerate(zip(seen, is_hidden, strict=True)):
            left = np.where(hidden[:, None], np.nan, positions)
            errors: dict[int, InputError] = {}
            if np.isnan(left).all():
                errors, left = {k: FormatError("hidden")}, self._binding.rest.vertices
            given = None if weights is None else weights.read(int(frames[k]), int(frames[k]) + 1)
            completed, given = complete_frames(solver.solver, left[None], given)
            block, solution = Block(k, completed, errors), solver.robust.solve(completed, given)
            blocks.append(solver.measure_block(block, given, solution, (b"",)))
        return blocks

    def _measure_hidden(
        self,
        blocks: Sequence[SolvedBlock],
        seen: Floats,
        is_hidden: Mask,
        smooth: float | Literal["auto"] | None,
    ) -> tuple[HiddenErrors, float] | None:
        """Measure the vertices that were hidden, (k, m), in smoothed frames; None without any.

        The second figure is the rms of those that are seen, in percent of the diagonal. Those that
        are hidden for too long count in no way: time does not tell where they are.
        """
        settings = CaptureSettings(smooth=smooth, fill_gaps=True)
        solver = self._block_solver.solver
        poses, occlusions = smooth_frames(solver, blocks, settings, self._fps)
        errors = np.linalg.norm(seen - reconstruct_frames(self._binding, poses), axis=2)
        is_counted = is_hidden & np.isfinite(errors)
        for k in range(len(seen)):
            if occlusions is not None:
                is_counted[k, occlusions.find_long(k)] = False
        errors *= 100 / self._binding.rest.diagonal
        hidden, others = errors[is_counted], errors[~is_hidden & np.isfinite(errors)]
        if not (len(hidden) and len(others)):
            return None
        rms, rest = (float(np.sqrt(np.mean(part**2))) for part in (hidden, others))
        frames = int(is_counted.any(axis=1).sum())
        return HiddenErrors(rms, float(hidden.max()), frames), rest

    def _try_robust(
        self, spread: Sequence[int], outliers: dict[int, Mask], *, is_torn: bool = False
    ) -> Iterator[TriedStep]:
        """Reject outliers, with the weights that such a run has, and with fitted ones.

        Cages are of least squares then. Weights that are fitted by default are not. Of a surface
        that is torn, errors are those of what is kept, and weights are not fitted.
        """
        if not self._rejects_outliers:
            return
        settings, stored = self._settings, self._stored
        has_default_fit = settings.fit is None and settings.builds_cage
        unfitted = stored.unfitted if has_default_fit else None
        plain = replace(settings.solve, norm=None)
        frames = list(outliers)[: MAX_REJECTED_FRAMES // 2]
        frames += [k for k in spread if k not in frames][:: MAX_TRIED_FRAMES // len(frames)]
        clip = {k: self._sequence.read_frame(k) for k in frames}
        solved = self._reject(unfitted or stored.binding, plain, clip, outliers)
        rebuilt = _list_rebuilt(solved)
        if is_torn:
            truth = {k: _keep(clip[k], solved[k]) for k in frames}
        else:
            truth = {k: self._restore(clip[k], rebuilt[k], outliers[k]) for k in frames}
        current = self._block_solver
        if not isinstance(current, CapturedBlockSolver):
            current = self._make_captured(current.solver)
        before = self._measure(truth, {k: self._solve(current, k, clip[k]) for k in frames})
        step = Step.TORN if is_torn else Step.ROBUST
        yield TriedStep(step, before, self._measure(truth, rebuilt), len(truth))
        fitted = self._fit(spread[1::2], plain) if self._takes_fit and not is_torn else None
        if fitted is not None:
            solved = self._reject(fitted, plain, clip, outliers)
            after = self._measure(truth, _list_rebuilt(solved))
            yield TriedStep(Step.ROBUST_FIT, before, after, len(truth))

    def _make_captured(self, solver: DualLaplacianSolver) -> CapturedBlockSolver[MeshSequence]:
        return CapturedBlockSolver(
            self._sequence,
            RobustSolver(solver),
            ProgressListener(),
            skips_bad_frames=self._settings.accepts_gaps,
            frame_weights=self._vertex_weights.frames,
        )

    def _reject(
        self,
        binding: Binding,
        solve: SolveSettings,
        clip: dict[int, Floats],
        outliers: dict[int, Mask],
    ) -> dict[int, Solution]:
        """Solve frames, (m, 3) each, with these weights, and with outliers rejected.

        The frames themselves tell what are none. A run solves them twice for that, as it does not
        know outliers; here those of the input are known, and left out the first time.
        """
        solver = self._make_captured(
            DualLaplacianSolver(binding, solve, self._vertex_weights.vertices)
        )
        completed = {
            k: solver.complete(Block(k, positions[None], {})) for k, positions in clip.items()
        }
        clean = (
            (positions, np.where(outliers[k][None], 0.0, 1.0 if given is None else given))
            for k, (positions, given) in completed.items()
        )
        robust = RobustSolver(solver.solver, measure_tolerances(solver.robust, clean))
        return {k: robust.solve(*frame) for k, frame in completed.items()}

    def _restore(self, positions: Floats, rebuilt: Floats, is_outlier: Mask) -> Floats:
        """Return a frame, (m, 3), whose outliers are where those around them tell.

        They are as far from their reconstruction as their neighbours on average.
        """
        left = np.where(is_outlier[:, None], 0.0, positions - rebuilt)
        rest = self._binding.rest
        share = average_neighbours(rest, (~is_outlier).astype(np.float64))
        means = np.stack([average_neighbours(rest, column) for column in left.T], axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):  # where all neighbours are outliers
            found = rebuilt + means / share[:, None]
        return np.where(is_outlier[:, None], found, positions)

    def _solve(
        self, solver: CapturedBlockSolver[MeshSequence], frame: int, positions: Floats
    ) -> Floats:
        """Return the reconstruction of a frame, (m, 3) as its positions, nan where missing."""
        completed, given = solver.complete(Block(frame, positions[None], {}))
        return np.asarray(solver.robust.solve(completed, given).reconstructions[0])

    def _measure(self, truth: dict[int, Floats], rebuilt: dict[int, Floats]) -> float:
        """Measure the rms error of frames, in percent of the diagonal, where the truth is known."""
        is_data, squares, count = self._block_solver.solver.vertex_weights > 0, 0.0, 0
        for k, positions in truth.items():
            errors = (positions - rebuilt[k])[is_data & np.isfinite(positions[:, 0])]
            squares, count = squares + float(np.vdot(errors, errors)), count + len(errors)
        return 100 / self._binding.rest.diagonal * float(np.sqrt(squares / max(1, count)))

    def _try_fit(self, spread: Sequence[int]) -> Iterator[TriedStep]:
        """Fit weights to every second frame, and measure the others."""
        solve = self._settings.solve
        fitted = self._fit(spread[1::2], solve) if self._takes_fit else None
        if fitted is None:
            return
        truth, errors = {k: self._sequence.read_frame(k) for k in spread[::2]}, []
        for binding in (self._binding, fitted):
            one = DualLaplacianSolver(binding, solve, self._vertex_weights.vertices)
            solver = self._make_captured(one)
            rebuilt = {k: self._solve(solver, k, positions) for k, positions in truth.items()}
            errors.append(self._measure(truth, rebuilt))
        yield TriedStep(Step.FIT, errors[0], errors[1], len(truth))

    def _fit(self, frames: Sequence[int], solve: SolveSettings) -> Binding | None:
        """Fit weights to frames in few rounds; None if memory is short, or the cage allows none."""
        from cageik_cli.fit.fit import Fitter
        from cageik_cli.fit.problem import estimate_memory

        m, n = self._binding.weights.shape
        needed = estimate_memory(m, n, jobs=1) + 4 * len(frames) * 3 * 8 * m
        if not frames or needed > max(self._settings.memory, FREE_MEMORY):
            return None
        clip = as_sequence(
            np.stack([self._sequence.read_frame(k) for k in frames]), self._binding.rest
        )
        try:
            fitter = Fitter(
                self._binding,
                FIT_SETTINGS,
                solve=solve,
                vertex_weights=self._vertex_weights.vertices,
                memory=needed,
            )
        except CageError:  # its four vertices determine the weights
            return None
        sample = fitter.sample([clip])
        alternator = fitter.make_alternator(sample, DEFAULT_STRENGTH, max_rounds=FIT_ROUNDS)
        return alternator.fit(sample.target, FIT_SETTINGS)[0]


def _list_rebuilt(solved: dict[int, Solution]) -> dict[int, Floats]:
    """Return the reconstructions of frames, (m, 3) each."""
    return {k: solution.reconstructions[0] for k, solution in solved.items()}


def _keep(positions: Floats, solution: Solution) -> Floats:
    """Return a frame, (m, 3), without the vertices that its solution rejects in part: nan."""
    weights = solution.weights
    return positions if weights is None else np.where(weights[0, :, None] < 1, np.nan, positions)
