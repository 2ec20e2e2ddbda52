"""Weights and cages fitted to each other by turns."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

import numpy as np

from cageik_cli.coordinates.binding import Binding
from cageik_cli.coordinates.fitting.displacements import Displacements
from cageik_cli.coordinates.fitting.problem import Motion, Solving, WeightProblem
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.solver.settings import SolveSettings
from cageik_cli.util.arrays import Floats
from cageik_cli.util.threads import OrderedMap

Form = TypeVar("Form")
"""How fitted weights are held: a `Correction` or `Influences`."""

HISTORY = 5
"""Rounds that the extrapolation looks back at."""

LEAST_MOTION = 1e-5
"""Share of the rest pose's diagonal that files of few digits round positions by."""

HISTORY_TOL = 1e-6
"""Directions of the history with smaller singular values, relative to the largest, are left out."""


@dataclass(frozen=True, slots=True)
class Effort:
    """When the rounds end, and how each is solved.

    Attributes
    ----------
    solving : Solving
        Of the weights in each round.
    min_gain : float
        Rounds end when two of them lower the error of the fitted frames by less than twice this
        share.
    """

    solving: Solving = field(default_factory=Solving)
    max_rounds: int = 12
    min_gain: float = 0.003


@dataclass(frozen=True, slots=True, eq=False)
class CageSolve:
    """The cage solve of the extraction, for displacements and any weights.

    Attributes
    ----------
    vertex_weights : (m,) float64 or None
        From `normalize_weights`.
    """

    binding: Binding
    settings: SolveSettings
    vertex_weights: Floats | None

    def prepare(self, weights: Floats) -> DualLaplacianSolver:
        """Factor the system of `weights`, (m, n)."""
        binding = replace(self.binding, weights=weights)
        return DualLaplacianSolver(binding, self.settings, self.vertex_weights)

    def solve(self, weights: Floats, target: Displacements, jobs: int = 1) -> "SolvedMotion":
        """Solve for the displacements of the cage, and measure the error of the vertices."""
        solver = self.prepare(weights)

        def solve_block(columns: Floats) -> tuple[Floats, float]:
            cages = solver.solve_displacements(columns)
            error = weights @ cages
            error -= columns
            error = error[solver.data_vertices]
            return cages, float(np.vdot(error, error))

        with OrderedMap(solve_block, target.blocks(), jobs, jobs) as solved:
            cages, squares = zip(*solved, strict=True)
        vertices = solver.data_count
        rms = np.sqrt(sum(squares) / (vertices * target.weight))
        least = LEAST_MOTION * self.binding.rest.diagonal
        return SolvedMotion(Motion(target, np.hstack(cages), least), float(rms))


@dataclass(frozen=True, slots=True, eq=False)
class SolvedMotion:
    """Displacements of a cage, and the root mean square distance that is left, in file units."""

    motion: Motion
    rms: float


class Extrapolation:
    """Anderson's acceleration of the rounds, in the displacements of the cages.

    A round maps the cages that the weights are fitted to onto the cages of those weights. The next
    round begins where a linear model of the last few rounds expects the map's fixed point
    (Anderson 1965; Walker and Ni 2011).
    """

    def __init__(self) -> None:
        self._given: list[Floats] = []
        self._found: list[Floats] = []

    def advance(self, given: Floats, found: Floats) -> Floats:
        """Return the cages of the next round, (n, 3k), from those of this one."""
        self._given = [*self._given, given.ravel()][-HISTORY:]
        self._found = [*self._found, found.ravel()][-HISTORY:]
        if len(self._found) == 1:
            return found
        images = np.stack(self._found)
        residuals = images - np.stack(self._given)
        changes = np.diff(residuals, axis=0).T
        shares = np.linalg.lstsq(changes, residuals[-1], rcond=HISTORY_TOL)[0]
        return np.asarray(found - (shares @ np.diff(images, axis=0)).reshape(found.shape))


@dataclass(frozen=True, slots=True, eq=False)
class Alternation(Generic[Form]):
    """The result of fitting weights and cages by turns.

    Attributes
    ----------
    form : Correction or Influences
        The fitted weights, in the form in which they were fitted.
    motion : Motion
        The displacements of the cages for the fitted weights.
    """

    form: Form
    motion: Motion


@dataclass(frozen=True, slots=True, eq=False)
class Alternator:
    """Fits weights and cages by turns until the error hardly falls."""

    problem: WeightProblem
    cage_solve: CageSolve
    effort: Effort

    def run(
        self,
        target: Displacements,
        start: Form,
        step: Callable[[Motion, Form], Form],
        expand: Callable[[Form], Floats],
    ) -> Alternation[Form]:
        """Fit to `target`.

        Parameters
        ----------
        start : Correction or Influences
            A first guess of the weights.
        step : callable
            One fit of the weights to given cages, from the last ones.
        expand : callable
            Returns the weights of a form, (m, n).
        """
        jobs = self.effort.solving.jobs
        form, solved = start, self.cage_solve.solve(expand(start), target, jobs)
        errors, extrapolation = [solved.rms], Extrapolation()
        given = solved.motion
        for _ in range(self.effort.max_rounds):
            form = step(given, form)
            solved = self.cage_solve.solve(expand(form), target, jobs)
            errors.append(solved.rms)
            if not self._is_gaining(errors):
                break
            given = replace(given, cages=extrapolation.advance(given.cages, solved.motion.cages))
        return Alternation(form, solved.motion)

    def _is_gaining(self, errors: list[float]) -> bool:
        """Return whether the last two rounds have lowered the error enough."""
        bound = 1 - 2 * self.effort.min_gain
        return len(errors) < 3 or errors[-1] < bound * errors[-3]
