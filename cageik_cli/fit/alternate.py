"""Weights and cages fitted to each other by turns."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np

from cageik_cli.fit.influences import Influences, refit_influences
from cageik_cli.fit.problem import ROUNDING_TOL, Displacements, Motion, WeightProblem
from cageik_cli.fit.settings import Comparison, Distances, FitSettings
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.weights.binding import Binding, Correction
from cageik_cli.util.arrays import Floats
from cageik_cli.util.threads import OrderedMap

Form = TypeVar("Form", Correction, Influences)
"""How weights are held while they are fitted."""

MAX_START_REGULARIZATION = 0.03
"""The weights whose largest influences are kept are fitted closely: what is cut off is lost."""


@dataclass(frozen=True, slots=True, eq=False)
class CageSolve:
    """The cage solve of the extraction, for displacements and any weights.

    The binding has the weights before the fit; vertex weights, (m,) or None, are those of
    `normalize_weights`.
    """

    binding: Binding
    settings: SolveSettings
    vertex_weights: Floats | None

    def prepare(self, weights: Floats) -> DualLaplacianSolver:
        """Factor the system of `weights`, (m, n)."""
        binding = replace(self.binding, weights=weights)
        return DualLaplacianSolver(binding, self.settings, self.vertex_weights)

    def solve(self, weights: Floats, target: Displacements, jobs: int) -> tuple[Motion, float]:
        """Return the motion of the cage, and what is left of the vertices' (rms, file units)."""
        solver = self.prepare(weights)

        def solve_block(columns: Floats) -> tuple[Floats, float]:
            cages = solver.solve_displacements(columns)
            error = weights @ cages
            error -= columns
            error = error[solver.data_vertices]
            return cages, float(np.vdot(error, error))

        with OrderedMap(solve_block, target.blocks(), jobs, jobs) as solved:
            cages, squares = zip(*solved, strict=True)
        rms = np.sqrt(sum(squares) / (solver.data_count * target.weight))
        least = ROUNDING_TOL * self.binding.rest.diagonal
        return Motion(target, np.hstack(cages), least), float(rms)

    def measure(self, weights: Floats, target: Displacements) -> Distances:
        """Measure the error of `weights`, (m, n), on frames whose cages are solved for them."""
        solver = self.prepare(weights)
        distances, counts, squares = [], [], 0.0
        shares = iter(target.shares[target.frames].tolist())
        for columns in target.blocks():
            error = weights @ solver.solve_displacements(columns)
            error -= columns
            error = error[solver.data_vertices]
            squares += float(np.vdot(error, error))
            lengths = np.sqrt(np.square(error).reshape(len(error), -1, 3).sum(axis=2))
            stands_for = np.array([next(shares) for _ in range(lengths.shape[1])])
            lengths /= np.sqrt(stands_for)
            distances.append(lengths.astype(np.float32).ravel())
            counts.append(np.tile(stands_for, len(lengths)))
        every = np.concatenate(distances)
        percent = 100 / self.binding.rest.diagonal
        mean = squares / (target.weight * len(every) / len(target))
        return Distances(
            rms=float(percent * np.sqrt(mean)),
            percentile=float(percent * find_weighted_percentile(every, np.concatenate(counts), 99)),
            largest=float(percent * every.max()),
        )

    def compare(self, weights: Floats, target: Displacements) -> Comparison:
        """Measure `weights`, (m, n), and those before the fit."""
        return Comparison(
            fitted=self.measure(weights, target),
            unfitted=self.measure(self.binding.weights, target),
            frames=len(target),
        )


def find_weighted_percentile(values: Floats, counts: Floats, percent: float) -> float:
    """Return the smallest of `values` that this percentage of them, each counted, is up to."""
    return float(np.percentile(values, percent, weights=counts, method="inverted_cdf"))


class Extrapolation:
    """Anderson's acceleration of the rounds, in the displacements of the cages.

    A round maps the cages that the weights are fitted to onto the cages of those weights. The next
    round begins where a linear model of the last few rounds expects the map's fixed point (Anderson
    1965; Walker and Ni 2011). Directions whose singular values are below the tolerance, relative to
    the largest, are left out.
    """

    def __init__(self, rounds: int = 5, tolerance: float = 1e-6) -> None:
        self._rounds, self._tolerance = rounds, tolerance
        self._given: list[Floats] = []
        self._found: list[Floats] = []

    def advance(self, given: Floats, found: Floats) -> Floats:
        """Return the cages of the next round, (n, 3k), from those of this one."""
        self._given = [*self._given, given.ravel()][-self._rounds :]
        self._found = [*self._found, found.ravel()][-self._rounds :]
        if len(self._found) == 1:
            return found
        images = np.stack(self._found)
        residuals = images - np.stack(self._given)
        changes = np.diff(residuals, axis=0).T
        shares = np.linalg.lstsq(changes, residuals[-1], rcond=self._tolerance)[0]
        return np.asarray(found - (shares @ np.diff(images, axis=0)).reshape(found.shape))


@dataclass(frozen=True, slots=True, eq=False)
class Alternator:
    """Fits weights and cages by turns until the error hardly falls.

    Rounds end when two of them lower the error of the fitted frames by less than twice `min_gain`,
    a share.
    """

    problem: WeightProblem
    cage_solve: CageSolve
    max_rounds: int
    min_gain: float = 0.003

    def fit(
        self, target: Displacements, settings: FitSettings
    ) -> tuple[Binding, Correction | None]:
        """Fit weights of the form that the settings ask for.

        Returned are a binding with these weights, and of a fit of low rank what it has added to the
        weights before, else None.
        """
        target = target.compress(self.problem.vertex_weights)
        if settings.rank is not None:
            whole, motion = self._fit_full_rank(target)
            start = self.problem.truncate(motion, whole, settings.rank)
            change, _ = self._alternate(target, start, self.problem.refit, self.problem.add_change)
            return self._bind(self.problem.add_change(change)), change
        if settings.influences is not None:
            strength = min(self.problem.regularization, MAX_START_REGULARIZATION)
            close = replace(self, problem=replace(self.problem, regularization=strength))
            weights = self.problem.add_change(close._fit_full_rank(target)[0])
            return self.fit_influences(target, weights, settings.influences), None
        change, _ = self._fit_full_rank(target)
        return self._bind(self.problem.add_change(change)), None

    def fit_influences(self, target: Displacements, whole: Floats, count: int) -> Binding:
        """Return the binding with at most `count` influences, from weights (m, n) that fit well."""
        n = whole.shape[1]
        start = Influences.from_dense(whole, count)
        step = partial(refit_influences, self.problem)
        found, _ = self._alternate(target, start, step, lambda form: form.to_dense(n))
        return self._bind(found.to_dense(n), has_offsets=True)

    def _fit_full_rank(self, target: Displacements) -> tuple[Correction, Motion]:
        """Return the change of all weights, and the motion of the cage for it."""
        start = Correction.none(*self.problem.rest_weights.shape)
        return self._alternate(target, start, self.problem.fit, self.problem.add_change)

    def _bind(self, weights: Floats, has_offsets: bool = False) -> Binding:
        return replace(self.cage_solve.binding, weights=weights, has_offsets=has_offsets)

    def _alternate(
        self,
        target: Displacements,
        start: Form,
        step: Callable[[Motion, Form], Form],
        expand: Callable[[Form], Floats],
    ) -> tuple[Form, Motion]:
        """Fit to `target`; return the weights in their form, and the motion of the cage for them.

        `step` fits the weights to given cages, from the last ones, and from `start` first;
        `expand` returns the weights (m, n) of a form.
        """
        jobs = self.problem.jobs
        form = start
        motion, rms = self.cage_solve.solve(expand(start), target, jobs)
        errors, extrapolation, given = [rms], Extrapolation(), motion
        for _ in range(self.max_rounds):
            form = step(given, form)
            motion, rms = self.cage_solve.solve(expand(form), target, jobs)
            errors.append(rms)
            is_gaining = len(errors) < 3 or errors[-1] < (1 - 2 * self.min_gain) * errors[-3]
            if not is_gaining:
                break
            given = replace(given, cages=extrapolation.advance(given.cages, motion.cages))
        return form, motion
