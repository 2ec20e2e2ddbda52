"""A mesh with skin weights, and the motion of its joints: one per cage vertex, below a root."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import CageError

MIN_WEIGHT = 1e-7
"""Smaller weights are dropped: beside a weight of 1, single precision loses them."""


@dataclass(frozen=True, slots=True, eq=False)
class SkinWeights:
    """The k influences of each of m vertices, the strongest first.

    Attributes
    ----------
    joints : (m, k) int64
        Joints of a row differ.
    values : (m, k) float64
        Not negative, rows sum to one; a row of fewer than k influences ends in zeros.
    """

    joints: Integers
    values: Floats

    def to_dense(self, count: int) -> Floats:
        """Return the weights as a matrix (m, count) over all joints."""
        matrix = np.zeros((len(self.joints), count))
        np.put_along_axis(matrix, self.joints, self.values, axis=1)
        return matrix


def compute_skin_weights(weights: Floats, block_rows: int = 1 << 14) -> SkinWeights:
    """Compute skin weights from cage weights, (m, n), whose rows sum to one.

    Negative ones are cut off, and the sum of the others is scaled to one.
    """
    blocks = [slice(row, row + block_rows) for row in range(0, len(weights), block_rows)]
    k = max(int((weights[rows] >= MIN_WEIGHT).sum(axis=1).max()) for rows in blocks)
    joints = np.empty((len(weights), k), np.int64)
    values = np.empty((len(weights), k))
    for rows in blocks:
        joints[rows] = np.argsort(-weights[rows], axis=1, kind="stable")[:, :k]
        largest = np.take_along_axis(weights[rows], joints[rows], axis=1)
        values[rows] = np.where(largest >= MIN_WEIGHT, largest, 0.0)
    sums = values.sum(axis=1, keepdims=True)
    if not sums.all():
        raise CageError(
            f"vertex {int(np.argmin(sums))} has no weight above zero; bind the mesh again"
        )
    return SkinWeights(joints, values / sums)


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """A mesh with skin weights, and how the whole of it turns.

    Attributes
    ----------
    rest : TriMesh
        m vertices.
    rotations : (F, 3, 3) float64
        R of each frame; `points @ R` turns points of the rest pose to it.
    turns : iterable of (n, 3, 3) float64, optional
        R of each joint, frame by frame, which are taken once and in order; joints that only
        translate have none, and turn with the whole.
    """

    rest: TriMesh
    weights: SkinWeights
    rotations: Floats
    turns: Iterable[Floats] | None = None


class JointMotion:
    """Places the joints of a skin frame by frame, for a rest cage of n vertices.

    The root is in the mean of the cage's vertices, and turns. Its children are where the cage's
    vertices are, and turn with it. So a skin of weights S gives

        S c + (X − S C) R,

    with X the rest mesh, c the cage of the frame, C the rest cage and R the rotation of the frame.
    If S are all the weights of a binding, this is `weights @ cage`, whatever R is. If the skin has
    turns R_j, its children turn by them instead, and a vertex x of weights s is at
    Σ_j s_j ((x − C_j) R_j + c_j).
    """

    def __init__(self, cage: TriMesh, skin: Skin) -> None:
        centre = cage.vertices.mean(axis=0)
        digits = max(3, len(str(len(cage.vertices) - 1)))
        self.names = ["root", *(f"cage_{k:0{digits}}" for k in range(len(cage.vertices)))]
        self.bind_places = np.vstack([centre, cage.vertices])
        self.rest_translations = np.vstack([centre, cage.vertices - centre])
        self.turn_count = 1 if skin.turns is None else len(self.names)
        self._skin, self._frame = skin, 0
        self._turns = None if skin.turns is None else iter(skin.turns)
        self._last = np.tile([0.0, 0.0, 0.0, 1.0], (self.turn_count, 1))

    def advance(self, frames: Floats) -> Iterator[tuple[Floats, Floats]]:
        """Yield the joints of the next k cages, (k, n, 3).

        These are the translations of the root and of its children relative to it, (n + 1, 3), and
        the quaternions of the first `turn_count` of them, the real part last: of all, or of the
        root alone. They have the signs that are nearer to the frame before, so that programs which
        interpolate take the short way.
        """
        from scipy.spatial.transform import Rotation

        for cage in frames:
            rotation = self._skin.rotations[self._frame]
            centre = cage.mean(axis=0)
            local = rotation[None]
            if self._turns is not None:
                local = np.concatenate([local, next(self._turns) @ rotation.T])
            found = Rotation.from_matrix(local.swapaxes(1, 2)).as_quat()
            is_far = np.einsum("jq,jq->j", found, self._last) < 0
            self._last = np.where(is_far[:, None], -found, found)
            self._frame += 1
            yield np.vstack([centre, (cage - centre) @ rotation.T]), self._last
