"""Fitted weights whose largest deviations are lowered, for cages in a norm above least squares.

With the deviations r_jf of vertex j in frame f, the rows of the weights minimise Σ ω_j φ(r_jf) in
place of Σ ω_j r_jf², with φ of `method.solve.norm`. The limit t is `ROW_LIMIT_RATIO` times the root
mean square of all frames, so that the worst frames gain most. Reweighted least squares would have a
weight for each vertex and frame, with which the columns of the weights do not separate any more
(`problem.py`). So a round moves the data instead: with factors φ'(r)/2r = max(1, r/t)^(p − 2), and
Ω_j the mean curvature of φ over the frames, each of which counts by r²,

    D̃_jf = D_jf + (factor_jf / Ω_j − 1) (D − W B)_jf

has, fitted by least squares with the weights Ω_j ω_j of vertices, the slope that the sum of φ has.
That is a step of Newton's method whose curvature is a mean, not a bound, over the frames: it has
converged in practice where the mean over r² bounds what counts.

The cages of the rounds are those of least squares. Cages in the norm, which the extraction solves,
would hide from the rows what these can lower better: rows that were fitted to them leave a larger
deviation, and take three times as long. On clips of a dancer, a horse and a cartoon chicken, cages
alone make the largest deviation half as large as least squares, rows and cages a quarter to a
third. The root mean square falls, too, as the rounds of least squares end early.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cageik_cli.fit.alternate import CageSolve
from cageik_cli.fit.problem import (
    ROUNDING_TOL,
    Displacements,
    Motion,
    WeightProblem,
)
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.norm import sum_squares, weigh_deviations
from cageik_cli.method.weights.binding import Correction
from cageik_cli.util.arrays import Floats
from cageik_cli.util.threads import OrderedMap

ROW_LIMIT_RATIO = 2.0
"""Limit, in the root mean square of all frames, above which deviations count by a higher power."""

NORM_ROUNDS, TRIAL_ROUNDS = 7, 3
"""Rounds of reweighting: one more makes the largest deviation 2 to 5 % smaller, and edits rougher.
Fits that only measure held-out frames take fewer, by which the largest deviation there is larger
by a few percent."""


def lower_deviations(
    problem: WeightProblem,
    cage_solve: CageSolve,
    target: Displacements,
    change: Correction,
    norm: float,
    rounds: int = NORM_ROUNDS,
) -> Correction:
    """Return a change of the weights that lowers the largest deviations, from a fitted one.

    Parameters
    ----------
    target : Displacements
        Of frames, not compressed. As much memory is taken once more.
    change : Correction
        Fitted by least squares.
    norm : float
        p, above 2.
    """
    for _ in range(rounds):
        motion, scales = _move_data(problem, cage_solve, target, change, norm)
        if problem.vertex_weights is not None:
            scales *= problem.vertex_weights
        change = replace(problem, vertex_weights=scales).fit(motion, change)
    return change


def _move_data(
    problem: WeightProblem,
    cage_solve: CageSolve,
    target: Displacements,
    change: Correction,
    norm: float,
) -> tuple[Motion, Floats]:
    """Return the motion with D̃ in place of D, and Ω, (m,), for these weights."""
    solver = cage_solve.prepare(problem.add_change(change))
    jobs = problem.jobs
    cages, parts, rms = _solve_errors(solver, target, jobs)
    limit = ROW_LIMIT_RATIO * rms if rms > 0 else np.inf
    shares = np.split(
        target.shares[target.frames],
        np.cumsum([part.shape[1] // 3 for part in parts])[:-1],
    )

    def weigh(part: NDArray[np.floating], counts: Floats) -> tuple[Floats, Floats]:
        """Return the squares of a part, which its shares have scaled, and the factors, (m, b)."""
        squares = sum_squares(part)
        return squares, weigh_deviations(np.sqrt(squares / counts), limit, norm)

    def sum_curvatures(item: tuple[NDArray[np.floating], Floats]) -> tuple[Floats, Floats]:
        squares, factors = weigh(*item)
        curvatures = np.where(factors > 1, (norm - 1) * factors, 1.0)
        return np.einsum("jk,jk->j", curvatures, squares), squares.sum(axis=1)

    bent, plain = np.zeros((2, len(solver.vertex_weights)))
    with OrderedMap(sum_curvatures, zip(parts, shares, strict=True), jobs, jobs) as sums:
        for found, counted in sums:
            bent += found
            plain += counted
    scales = np.divide(bent, plain, out=np.ones_like(bent), where=plain > 0)

    def move(item: tuple[NDArray[np.floating], Floats, Floats]) -> None:
        """Turn errors, in place, into D̃ = D + (factor / Ω − 1) (D − W B)."""
        part, counts, columns = item
        factors = weigh(part, counts)[1]
        factors /= scales[:, None]
        factors -= 1
        part *= np.repeat(factors, 3, axis=1)
        part += columns

    items = zip(parts, shares, target.blocks(), strict=True)
    with OrderedMap(move, items, jobs, jobs) as done:
        for _ in done:
            pass
    least = ROUNDING_TOL * cage_solve.binding.rest.diagonal
    frames = np.arange(len(target))
    data = Displacements(parts, frames, np.concatenate(shares))
    return Motion(data, cages, least), scales


def _solve_errors(
    solver: DualLaplacianSolver, target: Displacements, jobs: int
) -> tuple[Floats, tuple[NDArray[np.floating], ...], float]:
    """Solve the cages of least squares, (n, 3k).

    Also returned are the errors D − W B, in parts of (m, 3b), and their root mean square.
    """
    weights, dtype = solver.binding.weights, target.parts[0].dtype

    def solve_block(columns: Floats) -> tuple[Floats, NDArray[np.floating]]:
        cages = solver.solve_displacements(columns)
        errors = weights @ cages
        return cages, np.subtract(columns, errors, out=errors).astype(dtype, copy=False)

    with OrderedMap(solve_block, target.blocks(), jobs, jobs) as solved:
        cages, parts = zip(*solved, strict=True)
    squares = sum(np.einsum("jc,jc->j", part, part, dtype=np.float64) for part in parts)
    total = float(solver.vertex_weights @ squares)
    mean = total / (float(solver.vertex_weights.sum()) * target.weight)
    return np.hstack(cages), parts, float(np.sqrt(mean))
