"""Weights as 16-bit integers that move a mesh as the weights do.

Rounding loses little where a cage is known. But a pose solves for the cage by rows of the weights,
and amplifies errors of these in the smooth motions of the cage, which cost little energy. So what
rounding loses there is kept, too: one byte per vertex and motion.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import uniform_laplacian
from cageik_cli.util.arrays import Floats

SMOOTH_MOTIONS = 12
"""Motions of a cage in which weights are kept more precisely."""

MAX_REST = 127
"""Largest integer of what rounding lost."""

MAX_LEVEL = 20_000
"""Largest integer a weight is rounded to. Clips of a dance are drawn to 7e-6 diagonals (rms)."""

ROWS_PER_BLOCK = 4096
"""Rows that are rounded at once, so that memory does not grow with the model."""


@dataclass(frozen=True, slots=True, eq=False)
class RoundedWeights:
    """Weights: `integers / levels + rest_step * rests @ motions.T`.

    Attributes
    ----------
    integers : (m, n) int16
    levels : float
        The number of steps in a weight of one.
    motions : (n, q) float64
        Orthonormal motions of one coordinate of the cage.
    rests : (m, q) int8
        What rounding lost in these motions,
    rest_step : float
        in steps of this size.
    """

    integers: NDArray[np.int16]
    levels: float
    motions: Floats
    rests: NDArray[np.int8]
    rest_step: float

    def restore(self) -> Floats:
        """Return the weights, (m, n)."""
        return np.asarray(
            self.integers / self.levels + self.rest_step * self.rests @ self.motions.T
        )


def find_smooth_motions(cage: TriMesh) -> Floats:
    """Return the smoothest motions of a cage that are not that of the whole, (n, q)."""
    laplacian = uniform_laplacian(cage)
    vectors = np.linalg.eigh(laplacian.T @ laplacian)[1][:, : 1 + SMOOTH_MOTIONS]
    signs = np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(vectors.shape[1])])
    return np.asarray((vectors * signs)[:, 1:])


def round_weights(weights: Floats, motions: Floats) -> RoundedWeights:
    """Round weights (m, n), finite, of any sign, so that their rows keep their sums.

    The integers of a row whose sum is one have the sum `levels`, which is then a whole number: a
    cage that moves as one moves the mesh exactly so, however far. They are for displacements of a
    cage, so that the rest pose is exact.
    """
    top = float(np.abs(weights).max(initial=0.0)) or 1.0
    levels = MAX_LEVEL / top
    levels = float(np.floor(levels)) if levels >= 1 else levels
    integers = np.empty(weights.shape, np.int16)
    for start in range(0, len(weights), ROWS_PER_BLOCK):
        rows = slice(start, start + ROWS_PER_BLOCK)
        integers[rows] = _round_rows(weights[rows] * levels)
    lost = weights @ motions - integers @ motions / levels
    step = float(np.abs(lost).max(initial=0.0)) / MAX_REST or 1.0
    return RoundedWeights(integers, levels, motions, np.rint(lost / step).astype(np.int8), step)


def _round_rows(values: Floats) -> Floats:
    """Round rows to integers whose sums are the rounded sums, by the largest remainders."""
    rounded = np.rint(values)
    missing = np.rint(values.sum(axis=1)) - rounded.sum(axis=1)
    wanted = np.sign(missing)[:, None] * (values - rounded)
    places = np.argsort(-wanted, axis=1, kind="stable")
    is_changed = np.arange(values.shape[1]) < np.abs(missing)[:, None]
    changes = np.zeros_like(values)
    np.put_along_axis(changes, places, is_changed * np.sign(missing)[:, None], axis=1)
    return np.asarray(rounded + changes)
