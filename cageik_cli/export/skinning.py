"""Cage weights as skin weights: none negative, maybe few a vertex."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import InputError

LEAST_WEIGHT = 1e-7
"""Smaller weights are dropped: single precision beside a weight of one tells no smaller."""

_ROWS = 1 << 14


@dataclass(frozen=True, slots=True, eq=False)
class SkinWeights:
    """What moves each of m vertices: its k joints, the strongest first.

    Attributes
    ----------
    joints : (m, k) int64
        Joints of a row differ.
    values : (m, k) float64
        Not negative, rows sum to one; a row of fewer than k influences ends in zeros.
    """

    joints: Integers
    values: Floats

    def dense(self, count: int) -> Floats:
        """The same as a matrix (m, count) over all joints."""
        matrix = np.zeros((len(self.joints), count))
        np.put_along_axis(matrix, self.joints, self.values, axis=1)
        return matrix


def skin_weights(weights: Floats, most: int | None = None) -> SkinWeights:
    """The skin weights nearest to cage weights: negative ones cut off, the rest scaled to one.

    Parameters
    ----------
    weights : (m, n)
        Rows sum to one.
    most : int, optional
        Only the `most` largest of each row are kept, 1 or more; all if absent.

    Raises
    ------
    InputError
        When a row has no weight above zero.
    """
    blocks = [slice(row, row + _ROWS) for row in range(0, len(weights), _ROWS)]
    counts = [int((weights[rows] >= LEAST_WEIGHT).sum(axis=1).max()) for rows in blocks]
    k = min(most or max(counts), max(counts))
    joints = np.empty((len(weights), k), np.int64)
    values = np.empty((len(weights), k))
    for rows in blocks:
        joints[rows] = np.argsort(-weights[rows], axis=1, kind="stable")[:, :k]
        largest = np.take_along_axis(weights[rows], joints[rows], axis=1)
        values[rows] = np.where(largest >= LEAST_WEIGHT, largest, 0.0)
    sums = values.sum(axis=1, keepdims=True)
    if not sums.all():
        raise InputError(
            f"vertex {int(np.argmin(sums))} has no weight above zero; bind the mesh again"
        )
    return SkinWeights(joints, values / sums)


def furthest(offsets: Floats, excess: Floats, moves: Floats) -> float:
    """Largest distance between a skinned mesh and `H c`, over k frames.

    A skin of weights S takes a rest vertex p to p + S (c − c_rest); less H c, that is
    (p − H c_rest) + (S − H) (c − c_rest).

    Parameters
    ----------
    offsets : (m, 3)
        p − H c_rest.
    excess : (m, n)
        S − H.
    moves : (k, n, 3)
        c − c_rest of each frame.
    """
    columns = moves.transpose(1, 0, 2).reshape(excess.shape[1], -1)
    apart = (excess @ columns).reshape(len(offsets), -1, 3) + offsets[:, None]
    return float(np.linalg.norm(apart, axis=2).max())
