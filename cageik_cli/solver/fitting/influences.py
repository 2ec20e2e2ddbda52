"""Weights with few influences per vertex, for skeletons whose joints only move.

The K largest of weights that were fitted without this limit are kept. Then the cage solve
alternates with least squares on the simplex, each row near to the mean of itself and its
neighbours: that mean bounds the Dirichlet energy of the weights from above, so the rounds lower the
energy, and the weights are smooth over the surface.

Such weights do not reproduce the rest pose from the cage. Vertices are X + W (c - C), which is the
rest pose for the rest cage, and a rigid motion of the whole goes into a root transform.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cageik_cli.coordinates.fitting.displacements import Displacements
from cageik_cli.coordinates.fitting.problem import Motion
from cageik_cli.coordinates.fitting.simplex import Influences, SimplexStep
from cageik_cli.coordinates.fitting.systems import SurfaceLaplacian, count_columns
from cageik_cli.solver.fitting.alternate import Alternator
from cageik_cli.util.arrays import Floats

if TYPE_CHECKING:
    from scipy import sparse

SIMPLEX_STEPS = 15
"""Steps of the projected gradient in each round."""

MAX_START_REGULARIZATION = 0.03
"""The weights whose largest are kept are fitted closely: what is cut off is lost."""


def loosen(alternator: Alternator) -> Alternator:
    """Return the fit of the weights whose largest are kept."""
    problem = alternator.problem
    strength = min(problem.regularization, MAX_START_REGULARIZATION)
    return replace(alternator, problem=replace(problem, regularization=strength))


def fit_influences(
    alternator: Alternator, target: Displacements, whole: Floats, count: int
) -> Influences:
    """Fit weights with at most `count` influences to `target`, from weights (m, n) with all."""
    problem, n = alternator.problem, whole.shape[1]
    simplex = SimplexStep(
        problem.vertex_weights,
        problem.regularization,
        SIMPLEX_STEPS,
        alternator.effort.solving.jobs,
    )

    def step(motion: Motion, last: Influences) -> Influences:
        return simplex.fit(motion, last, _average_neighbours(last, problem.surface, n))

    start = Influences.from_dense(whole, count)
    return alternator.run(target, start, step, lambda found: found.to_dense(n)).form


def _average_neighbours(influences: Influences, surface: SurfaceLaplacian, n: int) -> Floats:
    """Return the mean of each row and of the mean of its neighbours, at its places, (m, K)."""
    dense = influences.to_dense(n)
    width = count_columns(len(dense))
    for start in range(0, n, width):
        block = dense[:, start : start + width]
        block -= surface.forward @ block / 2
    return np.take_along_axis(dense, influences.places, axis=1)


def to_sparse(influences: Influences, n: int) -> "sparse.csr_array":
    """Return the weights, (m, n), without the zeros."""
    from scipy import sparse

    m, count = influences.places.shape
    bounds = np.arange(m + 1) * count
    entries = influences.weights.ravel(), influences.places.ravel(), bounds
    matrix = sparse.csr_array(entries, shape=(m, n))
    matrix.eliminate_zeros()
    return matrix
