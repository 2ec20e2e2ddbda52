"""From a binding and clips to fitted weights, and a report that is honest about them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cageik_cli.fit.alternate import Alternator, CageSolve
from cageik_cli.fit.fitted import FittedWeights
from cageik_cli.fit.norm import lower_deviations
from cageik_cli.fit.problem import (
    AFFINE_FUNCTIONS,
    SurfaceLaplacian,
    WeightProblem,
    complement_basis,
    estimate_memory,
    restore_affine,
)
from cageik_cli.fit.sample import FrameReader, Sample, sample_frames
from cageik_cli.fit.settings import (
    DEFAULT_STRENGTH,
    Comparison,
    EditRoughness,
    FitRecord,
    FitReport,
    FitSettings,
    Strength,
    StrengthLimit,
    TriedStrength,
)
from cageik_cli.fit.strength import (
    EditMeter,
    Rung,
    Trial,
    choose_ladder,
    climb,
    take_rounds,
)
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.solve.vertex_weights import drop_unused_vertices
from cageik_cli.method.weights.binding import Binding, Correction
from cageik_cli.util.arrays import Floats, Mask
from cageik_cli.util.errors import CageError, SettingError
from cageik_cli.util.settings import DEFAULT_MEMORY
from cageik_cli.util.text import group_digits
from cageik_cli.util.threads import OrderedMap, limit_blas_threads

MAX_ROUNDS, MAX_HELD_OUT_ROUNDS = 12, 8
"""Rounds at a given strength. Fits that only measure held-out frames end earlier; their errors are
a few percent too high."""


class Fitter:
    """Fits the weights of a binding to clips.

    Parameters
    ----------
    binding : Binding
        Its weights, harmonic or not, are what the fitted ones are pulled to.
    vertex_weights : (m,) float64, optional
        From `normalize_weights`; a vertex of weight 0 is missing data.
    memory : int
        Limit in bytes for the fit, the weights included.
    jobs : int
        Threads. They do not change the weights.

    Attributes
    ----------
    cage_solve : CageSolve
        Solves cages, and measures errors, with the weights before the fit or others.

    Raises
    ------
    CageError
        When the cage is flat, or its four vertices determine the weights.
    SettingError
        When the cage has too few vertices for the rank or the influences, or a change of low rank
        is asked of weights that do not reproduce the rest pose.
    """

    def __init__(
        self,
        binding: Binding,
        settings: FitSettings | None = None,
        *,
        solve: SolveSettings | None = None,
        vertex_weights: Floats | None = None,
        memory: int = DEFAULT_MEMORY,
        jobs: int = 1,
    ) -> None:
        self._binding, self._settings = binding, settings or FitSettings()
        self._solve = solve or SolveSettings()
        self._memory, self._jobs = memory, jobs
        _check_freedom(binding, self._settings)
        weights = drop_unused_vertices(vertex_weights, binding.rest)
        self.cage_solve = CageSolve(binding, self._solve, weights)
        self._problem = WeightProblem(
            # A change of low rank is one of the binding's own weights, which a receiver computes.
            rest_weights=(
                restore_affine(binding.weights, binding.rest, binding.cage)
                if self._settings.rank is None
                else binding.weights
            ),
            complement=complement_basis(binding.cage),
            surface=SurfaceLaplacian(binding.rest),
            vertex_weights=weights,
            regularization=DEFAULT_STRENGTH.regularization,
            smoothness=DEFAULT_STRENGTH.smoothness,
        )

    def fit(self, clips: Sequence[FrameReader], skips_bad_frames: bool = False) -> FittedWeights:
        """Fit the weights to `clips`, and measure them.

        Returns
        -------
        FittedWeights
            The record of the fit does not describe the clips.

        Raises
        ------
        InputError
            When a frame cannot be read and must not be skipped.
        NumericalError
            When the system of the cages is singular.
        """
        with limit_blas_threads(1):  # its last digits depend on the number of threads
            sample = self.sample(clips, skips_bad_frames)
            solver = self.cage_solve.prepare(self._binding.weights)
            distinct = sample.count_distinct(solver)
            ladder, limit = choose_ladder(
                self._settings,
                distinct,
                can_hold_out=sample.can_hold_out,
                has_memory=self._can_climb(sample),
            )
            tried: list[TriedStrength] = []
            meter = EditMeter(self._problem, self._binding.cage)
            if len(ladder) == 1:
                # Before the fit to all frames, whose weights would be a large array meanwhile.
                held_out = self._compare_held_out(sample, ladder[0].strength)
                fitted, low_rank = self.fit_sample(sample, ladder[0].strength)
            else:
                ladder, limit, tried, held_out = self._climb(sample, ladder, meter)
                fitted, low_rank = self._follow(sample, ladder, meter)
            strength = ladder[-1].strength
            measured = self.cage_solve.compare(fitted.weights, sample.target)
            own_roughness = self._problem.surface.measure(self._binding.weights)
            roughness = self._problem.surface.measure(fitted.weights)
            report = FitReport(
                regularization=strength.regularization,
                smoothness=strength.smoothness,
                frames=sum(sample.lengths),
                fitted_frames=len(sample),
                needed_memory=sample.needed_memory,
                fitted=measured,
                held_out_blocks=held_out[0],
                copied_frames=sample.count_copies(solver, measured.fitted.rms),
                unseen_third=held_out[1],
                negative_per_row=abs(float(np.minimum(fitted.weights, 0).sum()))
                / len(fitted.weights),
                min_weight=float(fitted.weights.min()),
                roughness=roughness / own_roughness if own_roughness else 1.0,
                fixed_floats=_count_fixed_floats(fitted, low_rank),
                limit=limit,
                ladder=tuple(tried),
                edits=meter.measure_weights(fitted.weights),
                distinct_frames=distinct,
            )
        record = FitRecord(self._settings, self._solve, (), report)
        return FittedWeights(fitted, record, low_rank, self._binding)

    def sample(self, clips: Sequence[FrameReader], skips_bad_frames: bool = False) -> Sample:
        """Sample the frames of `clips`."""
        return sample_frames(
            clips,
            self.cage_solve.prepare(self._binding.weights),
            memory=self._memory,
            jobs=self._jobs,
            skips_bad_frames=skips_bad_frames,
        )

    def fit_sample(self, sample: Sample, strength: Strength) -> tuple[Binding, Correction | None]:
        """Fit the weights to a sample, with a given strength, and do not measure them.

        What is returned is as of `Alternator.fit`.
        """
        target = sample.target.compress(self._problem.vertex_weights)
        alternator = self.make_alternator(sample, strength)
        if self._norm is None:
            return alternator.fit(target, self._settings)
        change = alternator.fit_full_rank(target)
        del target  # it takes as much memory as lowering deviations does
        return self._fit_in_norm(alternator, sample, change, self._norm)

    def make_alternator(
        self, sample: Sample, strength: Strength, *, max_rounds: int = MAX_ROUNDS, share: int = 1
    ) -> Alternator:
        """Make what fits to a sample with a given strength, in the threads there is room for.

        It also fits weights for joints, see `rigs.skinning`. So many fits `share` the threads.
        """
        m, n = self._binding.weights.shape
        left = self._find_memory_left(sample)
        fitting = (k for k in range(self._jobs, 1, -1) if estimate_memory(m, n, k) <= left)
        problem = replace(
            self._problem,
            regularization=strength.regularization,
            smoothness=strength.smoothness,
            jobs=max(1, next(fitting, 1) // share),
        )
        return Alternator(problem, self.cage_solve, max_rounds)

    def _count_fits(self, sample: Sample) -> int:
        """Count the fits to parts of the sample that are made at once: one or two."""
        m, n = self._binding.weights.shape
        has_memory = 2 * estimate_memory(m, n, jobs=1) <= self._find_memory_left(sample)
        return 2 if has_memory and self._jobs > 1 else 1

    def _find_memory_left(self, sample: Sample) -> int:
        """Return the bytes that a fit may take beside the sample and its parts.

        The parts of two trials, the half and two thirds, are compressed, but for a norm.
        """
        parts = 1 if self._norm is None else 7 / 6
        return self._memory - int((1 + parts) * sample.target.nbytes)

    def _compare_held_out(self, sample: Sample, strength: Strength) -> list[Comparison | None]:
        """Fit to the frames of a sample that are not held out, and measure those that are.

        None where all or no frames are held out.
        """
        fits = self._count_fits(sample)
        alternator = self.make_alternator(
            sample, strength, max_rounds=MAX_HELD_OUT_ROUNDS, share=fits
        )

        def compare(is_held: Mask) -> Comparison | None:
            if is_held.all() or not is_held.any():
                return None
            trial = Trial(sample, is_held, self._problem)
            if self._norm is None:
                fitted, _ = alternator.fit(trial.seen, self._settings)
                return self.cage_solve.compare(fitted.weights, trial.held_out)
            trial.change = alternator.fit_full_rank(trial.seen)
            return self._compare_trial(trial, alternator)

        with OrderedMap(compare, sample.held_out_masks, fits, fits) as found:
            return list(found)

    def _can_climb(self, sample: Sample) -> bool:
        """Return whether there is memory for two trials beside each other."""
        m, n = self._binding.weights.shape
        kept = 4 * 8 * m * n  # of each, the weights at two strengths
        return bool(kept + estimate_memory(m, n, jobs=1) <= self._find_memory_left(sample))

    def _climb(
        self, sample: Sample, ladder: Sequence[Rung], meter: EditMeter
    ) -> tuple[tuple[Rung, ...], StrengthLimit, list[TriedStrength], list[Comparison | None]]:
        """Choose a strength by trials, and measure these with it on frames held out.

        Returned are the strengths down to the one chosen, what is against the next, all that were
        tried, and the measurements.
        """
        fits = self._count_fits(sample)
        trials = [
            Trial(sample, is_held, self._problem)
            for is_held in sample.held_out_masks
            if is_held.any() and not is_held.all()
        ]

        def advance(rung: Rung) -> tuple[float, float | None]:
            alternator = self.make_alternator(sample, rung.strength, share=fits)
            with OrderedMap(
                lambda one: one.advance(alternator, rung.rounds), trials, fits, fits
            ) as errors:
                blocks, *third = errors
            return blocks, third[0] if third else None

        def measure_edits() -> EditRoughness:
            found = [meter.measure(trial.change) for trial in trials]
            return max(found, key=lambda one: one.largest)

        count, limit, tried = climb(ladder, advance, measure_edits, self._settings.use)
        if count < len(tried):
            for trial in trials:
                trial.go_back()
        alternator = self.make_alternator(sample, ladder[count - 1].strength, share=fits)

        with OrderedMap(
            lambda trial: self._compare_trial(trial, alternator), trials, fits, fits
        ) as found:
            comparisons = [*found, None][:2]
        return tuple(ladder[:count]), limit, tried, comparisons

    def _compare_trial(self, trial: Trial, alternator: Alternator) -> Comparison:
        """Measure a trial on frames held out, in the form and the norm of the settings."""
        if self._norm is not None:
            trial.lower_deviations(alternator, self._norm)
        fitted, _ = alternator.fit(trial.seen, self._settings, trial.change)
        return self.cage_solve.compare(fitted.weights, trial.held_out)

    def _follow(
        self, sample: Sample, ladder: Sequence[Rung], meter: EditMeter
    ) -> tuple[Binding, Correction | None]:
        """Fit the weights to a sample at each strength of a ladder, as its trials were."""
        target, change = sample.target.compress(self._problem.vertex_weights), None
        for rung in ladder:
            alternator = self.make_alternator(sample, rung.strength)
            change = take_rounds(alternator, rung.rounds, target, change)
        alternator = self.make_alternator(sample, ladder[-1].strength)
        if change is None or self._norm is None:
            return alternator.fit(target, self._settings, change)
        del target  # it takes as much memory as lowering deviations does
        evened, low_rank = self._fit_in_norm(alternator, sample, change, self._norm)
        if self._settings.use == "edit":
            weights = alternator.problem.add_change(change)
            evened = replace(evened, weights=meter.blend(weights, evened.weights))
        return evened, low_rank

    @property
    def _norm(self) -> float | None:
        """The norm that weights lower the largest deviations by: all of them, or none."""
        settings, solve = self._settings, self._solve
        has_all = settings.rank is None and settings.influences is None
        return solve.norm if has_all and solve.lowers_deviations else None

    def _fit_in_norm(
        self, alternator: Alternator, sample: Sample, change: Correction, norm: float
    ) -> tuple[Binding, Correction | None]:
        """Lower the largest deviations of a sample, from a change that fits by least squares."""
        problem, target = alternator.problem, sample.target
        change = lower_deviations(problem, self.cage_solve, target, change, norm)
        return alternator.fit(target, self._settings, change)


def _check_freedom(binding: Binding, settings: FitSettings) -> None:
    """Refuse settings that the cage has too few vertices for."""
    n = binding.weights.shape[1]
    freedom = n - AFFINE_FUNCTIONS
    if freedom <= 0:
        raise CageError(
            f"the cage has {group_digits(n)} vertices, which determine the weights; expected at "
            "least "
            f"{AFFINE_FUNCTIONS + 1}: leave the fit out, or use a cage with more vertices"
        )
    for name, count, most in (
        ("rank", settings.rank, freedom),
        ("influences", settings.influences, n),
    ):
        if count is not None and count > most:
            raise SettingError(
                f"fit {name} is {count}, but the cage has {group_digits(n)} vertices; give "
                f"{most} or fewer"
            )
    if settings.rank is not None and binding.has_offsets:
        raise SettingError(
            f"fit rank is {settings.rank}, but the binding's weights have few influences and do "
            "not reproduce the rest pose; fit from the weights before that"
        )


def _count_fixed_floats(fitted: Binding, low_rank: Correction | None) -> int:
    """Count the numbers to store beside cages; of few influences, with places and offsets."""
    if low_rank is not None:
        return low_rank.columns.size + low_rank.basis.size
    if fitted.has_offsets:
        return 2 * int(np.count_nonzero(fitted.weights)) + fitted.rest.vertices.size
    return fitted.weights.size
