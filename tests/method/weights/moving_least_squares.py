"""A third kind of coordinates, which the tests add: w_i(x) = m_i p_i · M⁻¹ p, M = Σ m_i p_i p_iᵀ.

p is (1, x) and p_i that of cage vertex i, whose m_i falls with its distance from x (Lancaster and
Salkauskas 1981). Rows sum to one and reproduce affine maps.
"""

import numpy as np

from cageik_cli.method.weights.binding import Weights
from cageik_cli.method.weights.settings import COORDINATES, Coordinates

NAME = "least-squares"
HERE = "tests.method.weights.moving_least_squares"
KIND = Coordinates(
    version=1,
    function=f"{HERE}:compute_weights",
    field=f"{HERE}:Field",
    lowest_meaning="Weights of least squares may be negative.",
    lowest_expected="above -1",
)


def register():
    COORDINATES[NAME] = KIND


class Field:
    """Weights and gradients at points, in units of the cage's diagonal."""

    def __init__(self, cage, points, jobs=None):
        self._origin, self._scale = cage.vertices.mean(axis=0), cage.diagonal
        self._places = (cage.vertices - self._origin) / self._scale
        self._basis = np.column_stack([np.ones(len(self._places)), self._places])

    def _solve(self, points):
        """The strengths m, (q, n), M⁻¹, and M⁻¹ p, at points in these units."""
        steps = points[:, None] - self._places
        strengths = (np.einsum("qnx,qnx->qn", steps, steps) + 0.01) ** -2
        inverse = np.linalg.inv(np.einsum("qn,na,nb->qab", strengths, self._basis, self._basis))
        plain = np.column_stack([np.ones(len(points)), points])
        return steps, strengths, inverse, np.einsum("qab,qb->qa", inverse, plain)

    def evaluate(self, points):
        _, strengths, _, solved = self._solve((points - self._origin) / self._scale)
        return strengths * (solved @ self._basis.T)

    def gradient(self, points, jobs=None):
        steps, strengths, inverse, solved = self._solve((points - self._origin) / self._scale)
        slopes = -4 * steps * (strengths**1.5)[:, :, None]
        values = solved @ self._basis.T
        change = np.einsum("qnx,qn,na->qax", slopes, values, self._basis)
        turned = np.einsum("qab,qbx->qax", inverse, np.eye(4)[:, 1:] - change)
        gradients = slopes * values[:, :, None]
        gradients += strengths[:, :, None] * np.einsum("na,qax->qnx", self._basis, turned)
        return gradients / self._scale


def compute_weights(cage, points, jobs=None, progress=lambda done, count: None):
    progress(len(points), len(points))
    return Weights(Field(cage, points).evaluate(points))
