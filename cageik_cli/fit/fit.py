"""From a binding and clips to fitted weights, and a report that is honest about them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cageik_cli.fit.alternate import Alternator, CageSolve
from cageik_cli.fit.fitted import FittedWeights
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
    DEFAULT_REGULARIZATION,
    Comparison,
    FitRecord,
    FitReport,
    FitSettings,
)
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.solve.vertex_weights import drop_unused_vertices
from cageik_cli.method.weights.binding import Binding, Correction
from cageik_cli.util.arrays import Floats, Mask
from cageik_cli.util.errors import CageError, SettingError
from cageik_cli.util.settings import DEFAULT_MEMORY
from cageik_cli.util.threads import OrderedMap, limit_blas_threads

MAX_HELD_OUT_ROUNDS = 8
"""Fits that only measure held-out frames end earlier; their errors are a few percent too high."""

TRIED_REGULARIZATIONS = (1.0, 0.3, 0.1, 0.03, 0.01, 0.003)
"""Strengths that a search tries, two at a time, the smoothest weights first."""

MAX_ERROR_SHARE = 0.97
"""The search ends when the weaker of two strengths leaves more of the other's held-out error."""

MAX_BEST_RATIO = 1.05
"""The strongest regularization is chosen whose held-out error is within this of the smallest."""

Curve = list[tuple[float, float]]
"""Regularizations and their errors on held-out frames, in percent of the diagonal."""


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
    max_rounds : int
        Rounds of weights and cages by turns.

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
        max_rounds: int = 12,
    ) -> None:
        self._binding, self._settings = binding, settings or FitSettings()
        self._solve = solve or SolveSettings()
        self._memory, self._jobs, self._max_rounds = memory, jobs, max_rounds
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
            regularization=DEFAULT_REGULARIZATION,
            smoothness=self._settings.smoothness,
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
            strength, curve = self._choose_regularization(sample)
            # Before the fit to all frames, whose weights would be one more large array meanwhile.
            blocks, third = self._measure_unseen(sample, strength, is_strength_chosen=bool(curve))
            fitted, low_rank = self.fit_sample(sample, strength)
            measured = self.cage_solve.compare(fitted.weights, sample.target)
            solver = self.cage_solve.prepare(self._binding.weights)
            own_roughness = self._problem.surface.measure(self._binding.weights)
            roughness = self._problem.surface.measure(fitted.weights)
            report = FitReport(
                regularization=strength,
                smoothness=self._settings.smoothness,
                frames=sum(sample.lengths),
                fitted_frames=len(sample),
                needed_memory=sample.needed_memory,
                fitted=measured,
                held_out_blocks=blocks,
                copied_frames=sample.count_copies(solver, measured.fitted.rms),
                unseen_third=third,
                negative_per_row=abs(float(np.minimum(fitted.weights, 0).sum()))
                / len(fitted.weights),
                min_weight=float(fitted.weights.min()),
                roughness=roughness / own_roughness if own_roughness else 1.0,
                fixed_floats=_count_fixed_floats(fitted, low_rank),
                curve=tuple(curve),
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

    def fit_sample(self, sample: Sample, strength: float) -> tuple[Binding, Correction | None]:
        """Fit the weights to a sample, with a given regularization, and do not measure them.

        What is returned is as of `Alternator.fit`.
        """
        return self.make_alternator(sample, strength).fit(sample.target, self._settings)

    def make_alternator(
        self, sample: Sample, strength: float, is_trial: bool = False
    ) -> Alternator:
        """Make what fits to a sample with a given regularization, in the threads there is room for.

        It also fits weights for joints, see `rigs.joints`. A trial is one of the fits whose frames
        held out are measured: it shares the threads with those that are made at once, and has at
        most `MAX_HELD_OUT_ROUNDS`.
        """
        m, n = self._binding.weights.shape
        left = self._find_memory_left(sample)
        fitting = (k for k in range(self._jobs, 1, -1) if estimate_memory(m, n, k) <= left)
        jobs, rounds = next(fitting, 1), self._max_rounds
        if is_trial:
            jobs = max(1, jobs // self._count_fits(sample))
            rounds = min(rounds, MAX_HELD_OUT_ROUNDS)
        problem = replace(self._problem, regularization=strength, jobs=jobs)
        return Alternator(problem, self.cage_solve, rounds)

    def _count_fits(self, sample: Sample) -> int:
        """Count the fits to parts of the sample that are made at once: one or two."""
        m, n = self._binding.weights.shape
        has_memory = 2 * estimate_memory(m, n, jobs=1) <= self._find_memory_left(sample)
        return 2 if has_memory and self._jobs > 1 else 1

    def _find_memory_left(self, sample: Sample) -> int:
        """Return the bytes that a fit may take beside the sample and its part."""
        return self._memory - 2 * sample.target.nbytes

    def _choose_regularization(self, sample: Sample) -> tuple[float, Curve]:
        """Return the regularization, and what was tried if it is chosen by held-out blocks.

        Regularizations are tried while the error falls by a few percent.
        """
        if self._settings.regularization is not None:
            return self._settings.regularization, []
        curve: Curve = []
        for start in range(0, len(TRIED_REGULARIZATIONS), 2):
            pair = TRIED_REGULARIZATIONS[start : start + 2]
            cases = [(sample.in_held_out_block, s) for s in pair]
            for strength, found in zip(pair, self._compare_held_out(sample, cases), strict=True):
                if found is None:
                    return choose_regularization([]), []
                curve.append((strength, found.fitted.rms))
            if curve[-1][1] > MAX_ERROR_SHARE * curve[-2][1]:
                break
        return choose_regularization(curve), curve

    def _measure_unseen(
        self, sample: Sample, strength: float, is_strength_chosen: bool
    ) -> list[Comparison | None]:
        """Measure fits to blocks and to two thirds of a sample on the other blocks and third."""
        third, third_strength = sample.in_last_third, strength
        if is_strength_chosen and third.any() and not third.all():
            third_strength, _ = self._choose_regularization(sample.take(np.flatnonzero(~third)))
        cases = [(sample.in_held_out_block, strength), (third, third_strength)]
        return self._compare_held_out(sample, cases)

    def _compare_held_out(
        self, sample: Sample, cases: Sequence[tuple[Mask, float]]
    ) -> list[Comparison | None]:
        """Fit to the frames that are not held out, and measure those that are.

        Each case is which frames of the sample, (k,), are held out, and the regularization. None
        where all or no frames are held out.
        """

        def compare(case: tuple[Mask, float]) -> Comparison | None:
            is_held, strength = case
            if is_held.all() or not is_held.any():
                return None
            seen = sample.target.take(np.flatnonzero(~is_held))
            held_out = sample.target.take(np.flatnonzero(is_held))
            alternator = self.make_alternator(sample, strength, is_trial=True)
            fitted, _ = alternator.fit(seen, self._settings)
            return self.cage_solve.compare(fitted.weights, held_out)

        fits = self._count_fits(sample)
        with OrderedMap(compare, cases, fits, fits) as found:
            return list(found)


def _check_freedom(binding: Binding, settings: FitSettings) -> None:
    """Refuse settings that the cage has too few vertices for."""
    n = binding.weights.shape[1]
    freedom = n - AFFINE_FUNCTIONS
    if freedom <= 0:
        raise CageError(
            f"the cage has {n} vertices, which determine the weights; expected at least "
            f"{AFFINE_FUNCTIONS + 1}: leave the fit out, or use a cage with more vertices"
        )
    for name, count, most in (
        ("rank", settings.rank, freedom),
        ("influences", settings.influences, n),
    ):
        if count is not None and count > most:
            raise SettingError(
                f"fit {name} is {count}, but the cage has {n} vertices; give {most} or fewer"
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


def choose_regularization(curve: Curve) -> float:
    """Choose the strongest regularization whose error is nearly the smallest."""
    if not curve:
        return DEFAULT_REGULARIZATION
    best = min(error for _, error in curve)
    return max(strength for strength, error in curve if error <= MAX_BEST_RATIO * best)
