"""Weights with few influences per vertex, for skeletons whose joints only move.

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
from dataclasses import dataclass

import numpy as np

from cageik_cli.fit.problem import Motion, WeightProblem, count_columns
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.threads import OrderedMap


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
    goal = _average_neighbours(problem, start)
    m, count = start.places.shape
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


def _average_neighbours(problem: WeightProblem, influences: Influences) -> Floats:
    """Return the mean of each row and of the mean of its neighbours, at its places, (m, K)."""
    m, n = problem.rest_weights.shape
    dense, width = influences.to_dense(n), count_columns(m)
    for start in range(0, n, width):
        block = dense[:, start : start + width]
        block -= problem.surface.forward @ block / 2
    return np.take_along_axis(dense, influences.places, axis=1)


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
