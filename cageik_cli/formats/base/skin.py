"""A mesh with skin weights: what a file of a skeleton holds beside the motion of the joints."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import CageError

if TYPE_CHECKING:
    from scipy import sparse

MIN_WEIGHT = 1e-7
"""Smaller weights are dropped: beside a weight of 1, single precision loses them."""

JOINT_TEXT_BYTES = 600
"""Bytes that describe a joint and its motion in a .glb, about."""


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

    def to_sparse(self, count: int) -> "sparse.csr_array":
        """Return the weights as a sparse matrix (m, count) over all joints."""
        from scipy import sparse

        m, width = self.joints.shape
        rows = np.repeat(np.arange(m), width)
        entries = (self.values.ravel(), (rows, self.joints.ravel()))
        return sparse.csr_array(entries, shape=(m, count))


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
    cage_joints : (c,) int64, optional
        Which of the n joints each vertex of the cage has become; its own if absent.
    limbs : (n,) int64, optional
        Which limb, a part of the body, each joint is of; all are below the root if absent.
    error : float, optional
        The largest that the rms distance of the mesh from the input can be, percent of the
        diagonal of the rest pose; None where that is not known.
    """

    rest: TriMesh
    weights: SkinWeights
    rotations: Floats
    turns: Iterable[Floats] | None = None
    cage_joints: Integers | None = None
    limbs: Integers | None = None
    error: float | None = None


def count_skin_bytes(skin: Skin, joint_count: int) -> int:
    """Count the bytes that a skin with normals and its motion take in single precision.

    Weights are in sets of four, joints are named by 16 bits.
    """
    joint_count += 1 if skin.limbs is None else 2 + int(skin.limbs.max())  # the root, and limbs
    sets = -(-skin.weights.joints.shape[1] // 4)
    surface = (24 + sets * 4 * (4 + 2)) * len(skin.rest.vertices) + 12 * len(skin.rest.faces)
    return int(surface + joint_count * (JOINT_TEXT_BYTES + 28 * len(skin.rotations)))
