"""Weights as 16-bit integers that move a mesh as the weights do."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.util.arrays import Floats

MAX_LEVEL = 32_000
"""Largest integer a weight is rounded to; the rest of 16 bits is for rows to keep their sum."""

ROWS_PER_BLOCK = 4096
"""Rows that are rounded at once, so that memory does not grow with the model."""


@dataclass(frozen=True, slots=True, eq=False)
class RoundedWeights:
    """Weights that are integers times a step.

    Attributes
    ----------
    integers : (m, n) int16
    levels : float
        The number of steps in a weight of one.
    """

    integers: NDArray[np.int16]
    levels: float


def round_weights(weights: Floats) -> RoundedWeights:
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
    return RoundedWeights(integers, levels)


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
