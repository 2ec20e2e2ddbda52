"""Weights with few influences: not negative, with sum one, on chosen cage vertices per row.

For given cages, each row w of the weights minimises, over the simplex of its K cage vertices,

    ω |d − w B|²/s + λ |w − t|²,

with t the weights to be near to. All rows of a block take the steps of an accelerated projected
gradient together (Beck and Teboulle 2009), each with its own step length, and begin anew where
the momentum points uphill (O'Donoghue and Candès 2015).
"""

from dataclasses import dataclass

import numpy as np

from cageik_cli.coordinates.fitting.problem import Motion
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.threads import OrderedMap

MAX_BLOCK_ENTRIES = 1 << 19
"""Largest number of entries of the matrices of the rows that are solved together."""


@dataclass(frozen=True, slots=True, eq=False)
class Influences:
    """Weights of K cage vertices per vertex.

    Attributes
    ----------
    places : (m, K) int64
        Cage vertices, ascending in each row.
    weights : (m, K) float64
        Not negative; each row sums to one.
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


@dataclass(frozen=True, slots=True, eq=False)
class SimplexStep:
    """How weights on the simplex are fitted to given cages.

    Attributes
    ----------
    vertex_weights : (m,) float64 or None
    regularization : float
        λ.
    """

    vertex_weights: Floats | None
    regularization: float
    steps: int
    jobs: int

    def fit(self, motion: Motion, start: Influences, goal: Floats) -> Influences:
        """Return the best weights on the places of `start`, near to `goal`, (m, K)."""
        scale = motion.scale
        if not scale:
            return start
        gram = motion.cages @ motion.cages.T / scale
        cross = motion.target.multiply(motion.cages.T)
        right = np.take_along_axis(cross, start.places, axis=1) / scale
        del cross
        m, count = start.places.shape
        size = max(1, MAX_BLOCK_ENTRIES // count**2)

        def solve_rows(first: int) -> Floats:
            rows = slice(first, first + size)
            places = start.places[rows]
            matrices = gram[places[:, :, None], places[:, None, :]]
            linear = right[rows]
            if self.vertex_weights is not None:
                scales = self.vertex_weights[rows, None]
                matrices, linear = matrices * scales[:, :, None], linear * scales
            matrices[:, np.arange(count), np.arange(count)] += self.regularization
            linear = linear + self.regularization * goal[rows]
            return minimize_on_simplex(matrices, linear, start.weights[rows], self.steps)

        with OrderedMap(solve_rows, range(0, m, size), self.jobs, self.jobs) as solved:
            return Influences(start.places, np.concatenate(list(solved)))


def minimize_on_simplex(matrices: Floats, linear: Floats, start: Floats, steps: int) -> Floats:
    """Return the minima of ½ wᵀA w − bᵀw over the simplex, for many A and b.

    Parameters
    ----------
    matrices : (p, K, K)
        Symmetric, positive semidefinite.
    linear : (p, K)
    start : (p, K)
        On the simplex.
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

    References
    ----------
    Held, Wolfe and Crowder 1974.
    """
    counts = np.arange(1, points.shape[1] + 1)
    descending = -np.sort(-points, axis=1)
    excess = np.cumsum(descending, axis=1) - 1
    last = (descending * counts > excess).sum(axis=1, keepdims=True)
    shift = np.take_along_axis(excess, last - 1, axis=1) / last
    return np.asarray(np.maximum(points - shift, 0))
