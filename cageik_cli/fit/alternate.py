"""Weights and cages fitted to each other by turns.

Weights with few influences per vertex are for skeletons whose joints only move.
The K largest of weights that were fitted without this limit are kept. Then the cage solve
alternates with least squares on the simplex: weights that are not negative and sum to one. For
given cages, each row w minimises, over its K cage vertices,

    ω |d − w B|²/s + λ |w − t|²,

with t the mean of the row and of the mean of its neighbours. That mean bounds the Dirichlet energy
of the weights from above, so the rounds lower the energy, and the weights are smooth over the
surface. All rows of a block take the steps of an accelerated projected gradient together (Beck and
Teboulle 2009), each with its own step length, and begin anew where the momentum points uphill
(O'Donoghue and Candès 2015).

Such weights do not reproduce the rest pose from the cage. Vertices are X + W (c - C), which is the
rest pose for the rest cage, and a rigid motion of the whole goes into a root transform.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np

from cageik_cli.fit.problem import ROUNDING_TOL, Displacements, Motion, WeightProblem, count_columns
from cageik_cli.fit.settings import Comparison, Distances, FitSettings
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.weights.binding import Binding, Correction
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.threads import OrderedMap

Form = TypeVar("Form", Correction, "Influences")
"""How weights are held while they are fitted."""

MAX_EXTRAPOLATED_ROUNDS, EXTRAPOLATION_TOL = 5, 1e-6
"""Rounds that an extrapolation looks back at, and the smallest singular value that it uses."""

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
            error = weights @ solver.solve_frames(columns)
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
        """Measure `weights`, (m, n), and those before the fit, with cages of least squares.

        That is what they give by default without a fit.
        """
        plain = replace(self, settings=replace(self.settings, norm=None))
        return Comparison(
            fitted=self.measure(weights, target),
            unfitted=plain.measure(self.binding.weights, target),
            frames=len(target),
        )


def find_weighted_percentile(values: Floats, counts: Floats, percent: float) -> float:
    """Return the smallest of `values` that this percentage of them, each counted, is up to."""
    return float(np.percentile(values, percent, weights=counts, method="inverted_cdf"))


class Extrapolation:
    """Anderson's acceleration of the rounds, in the displacements of the cages.

    A round maps the cages that the weights are fitted to onto the cages of those weights. The next
    round begins where a linear model of the last few rounds expects the map's fixed point (Anderson
    1965; Walker and Ni 2011). Directions whose singular values are below `EXTRAPOLATION_TOL`,
    relative to the largest, are left out.
    """

    def __init__(self) -> None:
        self._given: list[Floats] = []
        self._found: list[Floats] = []

    def advance(self, given: Floats, found: Floats) -> Floats:
        """Return the cages of the next round, (n, 3k), from those of this one."""
        self._given = [*self._given, given.ravel()][-MAX_EXTRAPOLATED_ROUNDS:]
        self._found = [*self._found, found.ravel()][-MAX_EXTRAPOLATED_ROUNDS:]
        if len(self._found) == 1:
            return found
        images = np.stack(self._found)
        residuals = images - np.stack(self._given)
        changes = np.diff(residuals, axis=0).T
        shares = np.linalg.lstsq(changes, residuals[-1], rcond=EXTRAPOLATION_TOL)[0]
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
        self,
        target: Displacements,
        settings: FitSettings,
        change: Correction | None = None,
    ) -> tuple[Binding, Correction | None]:
        """Fit weights of the form that the settings ask for.

        Returned are a binding with these weights, and of a fit of low rank what it has added to the
        weights before, else None. `change` is that of all weights, if it is fitted already.
        """
        if settings.influences is not None:
            strength = min(self.problem.regularization, MAX_START_REGULARIZATION)
            close = replace(self, problem=replace(self.problem, regularization=strength))
            change = change or close.fit_full_rank(target)
            whole = self.problem.add_change(change)
            return self.fit_influences(target, whole, settings.influences), None
        change = change or self.fit_full_rank(target)
        if settings.rank is None:
            return self._bind(self.problem.add_change(change)), None
        motion, _ = self.cage_solve.solve(
            self.problem.add_change(change), target, self.problem.jobs
        )
        cut = self.problem.truncate(motion, change, settings.rank)
        cut = self._alternate(target, cut, self.problem.refit, self.problem.add_change)
        return self._bind(self.problem.add_change(cut)), cut

    def fit_influences(self, target: Displacements, whole: Floats, count: int) -> Binding:
        """Return the binding with at most `count` influences, from weights (m, n) that fit well."""
        n = whole.shape[1]
        start = Influences.from_dense(whole, count)
        step = partial(refit_influences, self.problem)
        found = self._alternate(target, start, step, lambda form: form.to_dense(n))
        return self._bind(found.to_dense(n), has_offsets=True)

    def fit_full_rank(self, target: Displacements, start: Correction | None = None) -> Correction:
        """Return the change of all weights, in rounds that begin with that of `start`."""
        start = start or Correction.none(*self.problem.rest_weights.shape)
        return self._alternate(target, start, self.problem.fit, self.problem.add_change)

    def _bind(self, weights: Floats, has_offsets: bool = False) -> Binding:
        return replace(self.cage_solve.binding, weights=weights, has_offsets=has_offsets)

    def _alternate(
        self,
        target: Displacements,
        start: Form,
        step: Callable[[Motion, Form], Form],
        expand: Callable[[Form], Floats],
    ) -> Form:
        """Fit to `target`; return the weights in their form.

        `step` fits the weights to given cages, from the last ones, and from `start` first;
        `expand` returns the weights (m, n) of a form.
        """
        jobs = self.problem.jobs
        form = start
        given, rms = self.cage_solve.solve(expand(form), target, jobs)
        errors, extrapolation = [rms], Extrapolation()
        for left in reversed(range(self.max_rounds)):
            form = step(given, form)
            if not left:
                break  # the cages would not be used
            motion, rms = self.cage_solve.solve(expand(form), target, jobs)
            errors.append(rms)
            is_gaining = len(errors) < 3 or errors[-1] < (1 - 2 * self.min_gain) * errors[-3]
            if not is_gaining:
                break
            given = replace(given, cages=extrapolation.advance(given.cages, motion.cages))
        return form


@dataclass(frozen=True, slots=True, eq=False)
class Influences:
    """Weights of K cage vertices per vertex.

    `places`, (m, K), are cage vertices, ascending in each row; weights, (m, K), are not negative,
    and each row sums to one.
    """

    places: Integers
    weights: Floats

    @staticmethod
    def from_dense(weights: Floats, count: int) -> "Influences":
        """Keep the `count` largest weights, (m, n), of each row, projected onto the simplex."""
        count = min(count, weights.shape[1])
        largest = np.argpartition(-weights, count - 1, axis=1)[:, :count]
        places = np.sort(largest, axis=1)
        kept = np.take_along_axis(weights, places, axis=1)
        return Influences(places, project_to_simplex(kept))

    def to_dense(self, cage_count: int) -> Floats:
        """Return the weights as (m, n)."""
        dense = np.zeros((len(self.places), cage_count))
        np.put_along_axis(dense, self.places, self.weights, axis=1)
        return dense


def refit_influences(
    problem: WeightProblem, motion: Motion, start: Influences, steps: int = 15
) -> Influences:
    """Return the best weights for these cages on the places of `start`, smooth over the surface."""
    scale = motion.scale
    if not scale:
        return start
    gram = motion.cages @ motion.cages.T / scale
    cross = motion.target.multiply(motion.cages.T)
    right = np.take_along_axis(cross, start.places, axis=1) / scale
    del cross

    def read_rows(rows: slice) -> tuple[Floats, Floats]:
        places = start.places[rows]
        return gram[places[:, :, None], places[:, None, :]], right[rows]

    return solve_rows(problem, start, read_rows, steps)


def solve_rows(
    problem: WeightProblem,
    start: Influences,
    read_rows: Callable[[slice], tuple[Floats, Floats]],
    steps: int = 15,
) -> Influences:
    """Return the best weights on the places of `start`, smooth over the surface.

    `read_rows` returns the matrices (p, K, K) and the right-hand sides (p, K) of some vertices.
    """
    m, count = start.places.shape
    # The mean of each row and of the mean of its neighbours, at its places, (m, K).
    dense, width = start.to_dense(problem.rest_weights.shape[1]), count_columns(m)
    for first in range(0, dense.shape[1], width):
        block = slice(first, first + width)
        dense[:, block] -= problem.surface.forward @ dense[:, block] / 2
    goal = np.take_along_axis(dense, start.places, axis=1)
    del dense
    size = max(1, (1 << 19) // count**2)  # rows whose matrices are solved together

    def solve_block(first: int) -> Floats:
        rows = slice(first, first + size)
        matrices, linear = read_rows(rows)
        if problem.vertex_weights is not None:
            scales = problem.vertex_weights[rows, None]
            matrices, linear = matrices * scales[:, :, None], linear * scales
        matrices[:, np.arange(count), np.arange(count)] += problem.regularization
        linear = linear + problem.regularization * goal[rows]
        return minimize_on_simplex(matrices, linear, start.weights[rows], steps)

    with OrderedMap(solve_block, range(0, m, size), problem.jobs, problem.jobs) as solved:
        return Influences(start.places, np.concatenate(list(solved)))


def minimize_on_simplex(matrices: Floats, linear: Floats, start: Floats, steps: int) -> Floats:
    """Return the minima of ½ wᵀA w − bᵀw over the simplex, for many A and b, from starts on it.

    A is (p, K, K), symmetric and positive semidefinite; b and the starts are (p, K).
    """
    lengths = 1 / np.abs(matrices).sum(axis=2).max(axis=1, keepdims=True)
    found, ahead = start, start
    momentum = np.ones((len(start), 1))
    for _ in range(steps):
        slope = np.matmul(matrices, ahead[:, :, None])[:, :, 0] - linear
        last, found = found, project_to_simplex(ahead - lengths * slope)
        moved = found - last
        uphill = np.einsum("pk,pk->p", ahead - found, moved)[:, None] > 0
        following = np.where(uphill, 1, (1 + np.sqrt(1 + 4 * momentum**2)) / 2)
        ahead = found + np.where(uphill, 0, (momentum - 1) / following) * moved
        momentum = following
    return np.asarray(found)


def project_to_simplex(points: Floats) -> Floats:
    """Return the nearest points, (p, K), that are not negative and sum to one in each row.

    Held, Wolfe and Crowder 1974.
    """
    counts = np.arange(1, points.shape[1] + 1)
    descending = -np.sort(-points, axis=1)
    excess = np.cumsum(descending, axis=1) - 1
    last = (descending * counts > excess).sum(axis=1, keepdims=True)
    shift = np.take_along_axis(excess, last - 1, axis=1) / last
    return np.asarray(np.maximum(points - shift, 0))
