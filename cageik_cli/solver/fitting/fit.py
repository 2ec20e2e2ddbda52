"""From a binding and clips to fitted weights, and a report that is honest about them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cageik_cli.coordinates.binding import Binding
from cageik_cli.coordinates.fitting.affine import AFFINE_FUNCTIONS, complement_basis, restore_affine
from cageik_cli.coordinates.fitting.problem import Solving, WeightProblem, estimate_memory
from cageik_cli.coordinates.fitting.systems import SurfaceLaplacian
from cageik_cli.solver.dual_laplacian import drop_unused_vertices
from cageik_cli.solver.fitting.alternate import Alternator, CageSolve, Effort
from cageik_cli.solver.fitting.held_out import (
    Comparison,
    HeldOut,
    count_copies,
    hold_out_blocks,
    hold_out_last_third,
)
from cageik_cli.solver.fitting.models import (
    FittedModel,
    ModelFit,
    choose_model,
    limit_influences,
)
from cageik_cli.solver.fitting.record import FitReport
from cageik_cli.solver.fitting.sample import (
    FrameReader,
    Sample,
    SampleSettings,
    sample_frames,
)
from cageik_cli.solver.settings import DEFAULT_REGULARIZATION, FitSettings, SolveSettings
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import CageError, SettingError
from cageik_cli.util.threads import limit_blas_threads

MAX_HELD_OUT_ROUNDS = 8
"""Fits that only measure held-out frames end earlier; their errors are a few percent too high."""

AUTO_CURVE = (1.0, 0.3, 0.1, 0.03, 0.01, 0.003)
"""Strengths of the regularization that are tried, two at a time, the smoothest weights first."""

AUTO_GAIN = 0.03
"""The search ends when the weaker of two strengths lowers the held-out error by less."""

AUTO_MARGIN = 1.05
"""The strongest regularization is chosen whose held-out error is within this of the best."""


Curve = list[tuple[float, float]]
"""Regularizations and their errors on held-out frames, in percent of the diagonal."""


@dataclass(frozen=True, slots=True, eq=False)
class FitConditions:
    """How frames are sampled and their cages solved.

    Attributes
    ----------
    vertex_weights : (m,) float64, optional
        From `normalize_weights`; a vertex of weight 0 is missing data.
    effort : Effort
        Its threads are those of `sampling`.
    """

    solve: SolveSettings = field(default_factory=SolveSettings)
    vertex_weights: Floats | None = None
    sampling: SampleSettings = field(default_factory=SampleSettings)
    effort: Effort = field(default_factory=Effort)


@dataclass(frozen=True, slots=True, eq=False)
class FittedWeights:
    """Weights fitted to clips.

    Attributes
    ----------
    binding : Binding
        With the fitted weights.
    model : FittedModel
        The weights in the form in which they are stored.

    Examples
    --------
    >>> from cageik_cli import bind, fit_weights, load_clip, load_mesh
    >>> clip = load_clip("data_fixtures/walker/frames", selection=slice(0, 12))
    >>> binding = bind(clip.first, load_mesh("data_fixtures/walker/cage.obj"), accuracy="preview")
    >>> fitted = fit_weights(binding, [clip])
    >>> fitted.binding.weights.shape, fitted.report.fitted_frames
    ((1570, 80), 12)
    >>> errors = fitted.report.held_out_blocks
    >>> errors.fitted.rms < errors.unfitted.rms
    True
    """

    binding: Binding
    model: FittedModel
    report: FitReport

    def __repr__(self) -> str:
        count, cage_count = self.binding.weights.shape
        return (
            f"<FittedWeights: {count} vertices in a cage of {cage_count}, fitted to "
            f"{self.report.fitted_frames} of {self.report.frames} frames>"
        )


def fit_weights(
    binding: Binding,
    clips: Sequence[FrameReader],
    settings: FitSettings | None = None,
    conditions: FitConditions | None = None,
) -> FittedWeights:
    """Fit the weights of a binding to one or several clips.

    Parameters
    ----------
    binding : Binding
        Its weights, harmonic or not, are what the fitted ones are pulled to.
    clips : sequence of FrameReader
        Clips of the rest pose's connectivity.

    Raises
    ------
    InputError
        When a frame cannot be read.
    CageError
        When the cage is flat.
    NumericalError
        When the system of the cages is singular.
    """
    settings, conditions = settings or FitSettings(), conditions or FitConditions()
    with limit_blas_threads(1):  # its last digits depend on the number of threads
        return Fitter(binding, settings, conditions).fit(clips)


class Fitter:
    """Fits the weights of a binding under given settings.

    Raises
    ------
    CageError
        When the cage is flat, or its four vertices determine the weights.
    SettingError
        When the cage has too few vertices for the rank or the influences, or a change of low rank
        is asked of weights that do not reproduce the rest pose.
    """

    def __init__(self, binding: Binding, settings: FitSettings, conditions: FitConditions) -> None:
        _check_freedom(binding, settings)
        weights = drop_unused_vertices(conditions.vertex_weights, binding.rest)
        conditions = replace(conditions, vertex_weights=weights)
        self._binding, self._settings, self._conditions = binding, settings, conditions
        self._cage_solve = CageSolve(binding, conditions.solve, weights)
        self._complement = complement_basis(binding.cage)
        self._surface = SurfaceLaplacian.from_mesh(binding.rest)
        # A change of low rank is one of the binding's own weights, which a receiver computes.
        self._start = (
            restore_affine(binding.weights, binding.rest, binding.cage)
            if settings.rank is None
            else binding.weights
        )

    def fit(self, clips: Sequence[FrameReader]) -> FittedWeights:
        """Fit the weights to `clips`, and measure them."""
        sample = self.sample(clips)
        strength, curve = self._choose_regularization(sample)
        # Before the fit to all frames, whose weights would be one more large array meanwhile.
        unseen = self._measure_unseen(sample, strength, is_strength_chosen=bool(curve))
        model = self.fit_model(sample, strength)
        binding = replace(
            self._binding, weights=model.weights, has_offsets=model.sparse_weights is not None
        )
        report = self._report(model, sample, _Unseen(strength, tuple(curve), *unseen))
        return FittedWeights(binding, model, report)

    def sample(self, clips: Sequence[FrameReader]) -> Sample:
        """Sample the frames of `clips`."""
        solver = self._cage_solve.prepare(self._binding.weights)
        return sample_frames(clips, solver, self._conditions.sampling)

    def fit_model(self, sample: Sample, strength: float) -> FittedModel:
        """Fit the weights to a sample, with a given regularization, and do not measure them."""
        effort = replace(self._conditions.effort, solving=Solving(jobs=self._count_jobs(sample)))
        return self._make_model(strength, effort)(sample.target)

    def limit_influences(self, sample: Sample, strength: float, count: int) -> FittedModel:
        """Fit weights with at most `count` influences to frames that the binding's weights give."""
        effort = replace(self._conditions.effort, solving=Solving(jobs=self._count_jobs(sample)))
        alternator = self._make_alternator(strength, effort)
        return limit_influences(alternator, sample.target, self._binding.weights, count)

    def _measure_unseen(
        self, sample: Sample, strength: float, is_strength_chosen: bool
    ) -> tuple[Comparison | None, Comparison | None]:
        """Measure fits to blocks and to two thirds of a sample on the other blocks and third."""
        blocks, third = hold_out_blocks(sample), hold_out_last_third(sample)
        third_strength = strength
        if is_strength_chosen and third.any() and not third.all():
            third_strength, _ = self._choose_regularization(sample.take(np.flatnonzero(~third)))
        cases = [
            (blocks, self._make_held_out_model(strength, sample)),
            (third, self._make_held_out_model(third_strength, sample)),
        ]
        on_blocks, on_third = self._plan_held_out(sample).compare(cases)
        return on_blocks, on_third

    def _report(self, model: FittedModel, sample: Sample, unseen: "_Unseen") -> FitReport:
        """Measure a model, beside the errors of frames that were not fitted."""
        weights = model.weights
        fitted = self._plan_held_out(sample).measure(weights, sample.target)
        solver = self._cage_solve.prepare(self._binding.weights)
        return FitReport(
            regularization=unseen.strength,
            smoothness=self._settings.smoothness,
            frames=sum(sample.lengths),
            fitted_frames=len(sample),
            needed_memory=sample.needed_memory,
            fitted=fitted,
            held_out_blocks=unseen.blocks,
            copied_frames=count_copies(sample, hold_out_blocks(sample), solver, fitted.fitted.rms),
            unseen_third=unseen.third,
            negative_per_row=abs(float(np.minimum(weights, 0).sum())) / len(weights),
            min_weight=float(weights.min()),
            roughness=self._compare_roughness(weights),
            fixed_floats=model.fixed_floats,
            curve=unseen.curve,
        )

    def _make_model(self, strength: float, effort: Effort) -> ModelFit:
        """Return the fit of the model that the settings ask for."""
        alternator = self._make_alternator(strength, effort)
        return choose_model(alternator, self._complement, self._settings)

    def _make_held_out_model(self, strength: float, sample: Sample) -> ModelFit:
        """Return the fit of the model to parts of a sample, one of those at the same time."""
        jobs = max(1, self._count_jobs(sample) // self._plan_held_out(sample).jobs)
        effort = self._conditions.effort
        rounds = min(effort.max_rounds, MAX_HELD_OUT_ROUNDS)
        return self._make_model(
            strength, replace(effort, max_rounds=rounds, solving=Solving(jobs=jobs))
        )

    def _make_alternator(self, strength: float, effort: Effort) -> Alternator:
        """Return the fit of weights and cages by turns."""
        problem = WeightProblem(
            self._start,
            self._surface,
            self._conditions.vertex_weights,
            strength,
            self._settings.smoothness,
        )
        return Alternator(problem, self._cage_solve, effort)

    def _count_jobs(self, sample: Sample) -> int:
        """Count the threads that there is memory for beside the sample, at least one."""
        m, n = self._binding.weights.shape
        sampling = self._conditions.sampling
        left = sampling.memory - 2 * sample.target.nbytes
        jobs = range(sampling.jobs, 1, -1)
        return next((count for count in jobs if estimate_memory(m, n, count) <= left), 1)

    def _plan_held_out(self, sample: Sample) -> HeldOut:
        """Plan fits at the same time if there are threads and memory for them."""
        m, n = self._binding.weights.shape
        left = self._conditions.sampling.memory - 2 * sample.target.nbytes
        has_memory = 2 * estimate_memory(m, n, jobs=1) <= left
        jobs = 2 if has_memory and self._conditions.sampling.jobs > 1 else 1
        return HeldOut(self._cage_solve, sample, jobs)

    def _choose_regularization(self, sample: Sample) -> tuple[float, Curve]:
        """Return the regularization, and what was tried if it is chosen by held-out blocks."""
        if self._settings.regularization is not None:
            return self._settings.regularization, []
        curve = self._search_regularization(sample)
        return choose_regularization(curve), curve

    def _search_regularization(self, sample: Sample) -> Curve:
        """Measure regularizations on held-out blocks, while the error falls."""
        held_out = self._plan_held_out(sample)
        mask = hold_out_blocks(sample)
        curve: Curve = []
        for start in range(0, len(AUTO_CURVE), 2):
            strengths = AUTO_CURVE[start : start + 2]
            cases = [(mask, self._make_held_out_model(s, sample)) for s in strengths]
            for strength, found in zip(strengths, held_out.compare(cases), strict=True):
                if found is None:
                    return []
                curve.append((strength, found.fitted.rms))
            if curve[-1][1] > (1 - AUTO_GAIN) * curve[-2][1]:
                break
        return curve

    def _compare_roughness(self, weights: Floats) -> float:
        """Return the roughness of `weights` relative to that of the binding's."""
        own = self._surface.measure(self._binding.weights)
        return self._surface.measure(weights) / own if own else 1.0


@dataclass(frozen=True, slots=True)
class _Unseen:
    """How the regularization was found, and the errors on frames that a fit did not see."""

    strength: float
    curve: tuple[tuple[float, float], ...]
    blocks: Comparison | None
    third: Comparison | None


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


def choose_regularization(curve: Curve) -> float:
    """Choose the strongest regularization whose error is near the smallest of the curve."""
    if not curve:
        return DEFAULT_REGULARIZATION
    best = min(error for _, error in curve)
    return max(strength for strength, error in curve if error <= AUTO_MARGIN * best)
