"""Weights and cages fitted to each other by turns."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from cageik_cli.coordinates.binding import Binding
from cageik_cli.coordinates.fitting.displacements import Displacements
from cageik_cli.coordinates.fitting.problem import Correction, Motion, Solving, WeightProblem
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.solver.settings import SolveSettings
from cageik_cli.util.arrays import Floats

MAX_ROUNDS = 8
MIN_GAIN = 0.01
"""Rounds end when the error of the fitted frames falls by less than this share."""


@dataclass(frozen=True, slots=True, eq=False)
class CageSolve:
    """The cage solve of the extraction, for displacements and any weights.

    Attributes
    ----------
    binding : Binding
    settings : SolveSettings
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

    def solve(self, weights: Floats, target: Displacements) -> "SolvedMotion":
        """Solve for the displacements of the cage, and measure the error of the vertices."""
        solver = self.prepare(weights)
        cages, squares, count = [], 0.0, 0
        for columns in target.blocks():
            cages.append(solver.solve_displacements(columns))
            error = (weights @ cages[-1] - columns)[solver.data_vertices]
            squares += float(np.square(error).sum())
            count += error.size // 3
        return SolvedMotion(Motion(target, np.hstack(cages)), float(np.sqrt(squares / count)))


@dataclass(frozen=True, slots=True, eq=False)
class SolvedMotion:
    """Displacements of a cage, and the root mean square distance that is left, in file units."""

    motion: Motion
    rms: float


@dataclass(frozen=True, slots=True, eq=False)
class Alternation:
    """The result of fitting weights and cages by turns.

    Attributes
    ----------
    correction : Correction
        The change of the weights.
    solved : SolvedMotion
        The cages for the fitted weights.
    rms : tuple of float
        Error of the fitted frames before each round and after the last, in file units.
    """

    correction: Correction
    solved: SolvedMotion
    rms: tuple[float, ...]


Step = Callable[[Motion, Correction | None], Correction]
"""One fit of the weights to given cages, from the last change."""


def alternate(
    problem: WeightProblem,
    cage_solve: CageSolve,
    target: Displacements,
    step: Step,
    start: Correction | None = None,
) -> Alternation:
    """Fit weights and cages by turns until the error hardly falls.

    Parameters
    ----------
    problem : WeightProblem
    cage_solve : CageSolve
    target : Displacements
    step : callable
        The fit of the weights.
    start : Correction, optional
        A first guess.
    """
    correction, weights = start, problem.rest_weights
    if start is not None:
        weights = start.add_to(weights)
    solved = cage_solve.solve(weights, target)
    errors = [solved.rms]
    for _ in range(MAX_ROUNDS):
        del weights  # the step needs the memory
        correction = step(solved.motion, correction)
        weights = correction.add_to(problem.rest_weights)
        solved = cage_solve.solve(weights, target)
        errors.append(solved.rms)
        if errors[-1] >= (1 - MIN_GAIN) * errors[-2]:
            break
    assert correction is not None
    return Alternation(correction, solved, tuple(errors))
