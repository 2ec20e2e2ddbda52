"""From a binding and clips to fitted weights, and a report that is honest about them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cageik_cli.coordinates.binding import Binding
from cageik_cli.coordinates.fitting.affine import complement_basis, restore_affine
from cageik_cli.coordinates.fitting.problem import Solving, WeightProblem, estimate_memory
from cageik_cli.coordinates.fitting.systems import SurfaceLaplacian
from cageik_cli.solver.fitting.alternate import Alternator, CageSolve, Effort
from cageik_cli.solver.fitting.bound import bound_rank
from cageik_cli.solver.fitting.held_out import (
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
    MAX_FIT_JOBS,
    FrameReader,
    Sample,
    SampleSettings,
    sample_frames,
)
from cageik_cli.solver.settings import DEFAULT_REGULARIZATION, FitSettings, SolveSettings
from cageik_cli.util.arrays import Floats
from cageik_cli.util.threads import limit_blas_threads

MAX_HELD_OUT_ROUNDS = 8
"""Fits that only measure held-out frames end earlier; their errors are a few percent too high."""

AUTO_CURVE = (1.0, 0.3, 0.1, 0.03, 0.01, 0.003)
"""Strengths of the regularization that are tried, two at a time, the smoothest weights first."""

AUTO_GAIN = 0.03
"""The search ends when the weaker of two strengths lowers the held-out error by less."""

AUTO_MARGIN = 1.05
"""The strongest regularization is chosen whose held-out error is within this of the best."""


@dataclass(frozen=True, slots=True, eq=False)
class FitConditions:
    """How frames are sampled and their cages solved.

    Attributes
    ----------
    solve : SolveSettings
    vertex_weights : (m,) float64, optional
        From `normalize_weights`; a vertex of weight 0 is missing data.
    sampling : SampleSettings
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
    report : FitReport

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
    settings : FitSettings, optional
    conditions : FitConditions, optional

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

    Parameters
    ----------
    binding : Binding
    settings : FitSettings
    conditions : FitConditions
    """

    def __init__(self, binding: Binding, settings: FitSettings, conditions: FitConditions) -> None:
        self._binding, self._settings, self._conditions = binding, settings, conditions
        self._cage_solve = CageSolve(binding, conditions.solve, conditions.vertex_weights)
        self._complement = complement_basis(binding.cage)
        self._surface = SurfaceLaplacian.from_mesh(binding.rest)
        self._jobs = min(conditions.sampling.jobs, MAX_FIT_JOBS)

    def fit(self, clips: Sequence[FrameReader]) -> FittedWeights:
        """Fit the weights to `clips`, and measure them."""
        sample = self.sample(clips)
        strength, curve = self._settings.regularization, list[tuple[float, float]]()
        if strength is None:
            curve = self._search_regularization(sample)
            strength = choose_regularization(curve)
        model = self.fit_model(sample, strength)
        binding = replace(
            self._binding, weights=model.weights, has_offsets=model.sparse_weights is not None
        )
        return FittedWeights(binding, model, self._report(strength, curve, model, sample))

    def sample(self, clips: Sequence[FrameReader]) -> Sample:
        """Sample the frames of `clips`."""
        solver = self._cage_solve.prepare(self._binding.weights)
        return sample_frames(clips, solver, self._conditions.sampling)

    def fit_model(self, sample: Sample, strength: float) -> FittedModel:
        """Fit the weights to a sample, with a given regularization, and do not measure them."""
        return self._make_model(strength, self._jobs, is_held_out=False)(sample.target)

    def limit_influences(self, sample: Sample, strength: float, count: int) -> FittedModel:
        """Fit weights with at most `count` influences to frames that the binding's weights give."""
        alternator = self._make_alternator(strength, self._jobs, is_held_out=False)
        return limit_influences(alternator, sample.target, self._binding.weights, count)

    def _report(
        self,
        strength: float,
        curve: Sequence[tuple[float, float]],
        model: FittedModel,
        sample: Sample,
    ) -> FitReport:
        """Measure a model, and fits to parts of the sample on the other parts."""
        weights = model.weights
        held_out = self._plan_held_out(sample)
        fit_seen = self._make_model(strength, self._jobs // held_out.jobs, is_held_out=True)
        cases = [(mask(sample), fit_seen) for mask in (hold_out_blocks, hold_out_last_third)]
        blocks, third = held_out.compare(cases)
        fitted = held_out.measure(weights, sample.target)
        solver = self._cage_solve.prepare(self._binding.weights)
        return FitReport(
            regularization=strength,
            smoothness=self._settings.smoothness,
            frames=sum(sample.lengths),
            fitted_frames=len(sample),
            fitted=fitted,
            held_out_blocks=blocks,
            copied_frames=count_copies(sample, hold_out_blocks(sample), solver, fitted.fitted.rms),
            unseen_third=third,
            bound=bound_rank(solver, sample.target, weights.shape[1]),
            negative_per_row=abs(float(np.minimum(weights, 0).sum())) / len(weights),
            min_weight=float(weights.min()),
            roughness=self._compare_roughness(weights),
            fixed_floats=model.fixed_floats,
            curve=tuple(curve),
        )

    def _make_model(self, strength: float, jobs: int, is_held_out: bool) -> ModelFit:
        """Return the fit of the model that the settings ask for."""
        alternator = self._make_alternator(strength, jobs, is_held_out)
        return choose_model(alternator, self._complement, self._settings)

    def _make_alternator(self, strength: float, jobs: int, is_held_out: bool) -> Alternator:
        """Return the fit of weights and cages by turns."""
        effort = replace(self._conditions.effort, solving=Solving(jobs=max(1, jobs)))
        if is_held_out:
            effort = replace(effort, max_rounds=min(effort.max_rounds, MAX_HELD_OUT_ROUNDS))
        is_exact = self._settings.rank is None
        weights = self._binding.weights
        problem = WeightProblem(
            restore_affine(weights, self._binding.rest, self._binding.cage)
            if is_exact
            else weights,
            self._surface,
            self._conditions.vertex_weights,
            strength,
            self._settings.smoothness,
        )
        return Alternator(problem, self._cage_solve, effort)

    def _plan_held_out(self, sample: Sample) -> HeldOut:
        """Plan fits at the same time if there are threads and memory for them."""
        m, n = self._binding.weights.shape
        sampling = self._conditions.sampling
        has_memory = 2 * estimate_memory(m, n, 1) + sample.target.nbytes < sampling.memory
        return HeldOut(self._cage_solve, sample, 2 if has_memory and self._jobs > 1 else 1)

    def _search_regularization(self, sample: Sample) -> list[tuple[float, float]]:
        """Measure regularizations on held-out blocks, while the error falls."""
        held_out = self._plan_held_out(sample)
        mask = hold_out_blocks(sample)
        curve: list[tuple[float, float]] = []
        for start in range(0, len(AUTO_CURVE), 2):
            strengths = AUTO_CURVE[start : start + 2]
            jobs = self._jobs // held_out.jobs
            cases = [(mask, self._make_model(s, jobs, is_held_out=True)) for s in strengths]
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


def choose_regularization(curve: Sequence[tuple[float, float]]) -> float:
    """Choose the strongest regularization whose error is near the smallest of the curve."""
    if not curve:
        return DEFAULT_REGULARIZATION
    best = min(error for _, error in curve)
    return max(strength for strength, error in curve if error <= AUTO_MARGIN * best)
