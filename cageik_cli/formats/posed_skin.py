"""A skin as programs pose it from a file: what is left out of the file or rounded is measured."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.skeleton import Skeleton
from cageik_cli.formats.joint_keys import JointKeys
from cageik_cli.util.arrays import Floats

if TYPE_CHECKING:
    from scipy import sparse

ReadFrames = Callable[[int, int], tuple[Floats, Floats]]
"""Returns translations (k, J, 3) and quaternions (k, T, 4) of frames from the first number on."""

MIN_JOINT_REACH = 1e-9
"""How far a joint moves a vertex, at least: a share, or a share of the size of the model."""

FRAMES_PER_BLOCK = 16
"""Frames that are posed together."""


class PosedSkin:
    """Vertices at rest, (m, 3), with weights (m, n), below the joints of a skeleton."""

    def __init__(
        self,
        vertices: NDArray[np.floating],
        weights: "sparse.csr_array",
        bind_places: Floats,
        skeleton: Skeleton,
    ) -> None:
        self.vertices, self._weights, self._skeleton = (
            vertices.astype(np.float64),
            weights,
            skeleton,
        )
        self._bind_places = bind_places

    def pose(self, moves: Floats, turns: Floats) -> Floats:
        """Return the vertices (k, m, 3), for translations (k, J, 3) and quaternions (k, T, 4)."""
        from scipy.spatial.transform import Rotation

        skeleton, (count, joint_count, _) = self._skeleton, moves.shape
        local = np.tile(np.eye(3), (count, joint_count, 1, 1))
        matrices = Rotation.from_quat(turns.reshape(-1, 4)).as_matrix().swapaxes(1, 2)
        local[:, : turns.shape[1]] = matrices.reshape(count, -1, 3, 3)
        places, rotations = moves.copy(), local
        for j, parent in enumerate(skeleton.parents.tolist()):
            if parent >= 0:
                places[:, j] = (moves[:, j, None] @ rotations[:, parent])[:, 0] + places[:, parent]
                rotations[:, j] = local[:, j] @ rotations[:, parent]
        rotations, places = rotations[:, skeleton.lead :], places[:, skeleton.lead :]
        shifts = places - np.einsum("na,knab->knb", self._bind_places, rotations)
        posed = self._multiply(shifts)
        for axis in range(3):
            posed += self.vertices[:, axis, None] * self._multiply(rotations[:, :, axis])
        return posed.reshape(len(self.vertices), count, 3).swapaxes(0, 1)

    def measure_reach(self) -> tuple[Floats, Floats]:
        """Return how far a vertex can move by a unit of each joint's translation and rotation.

        They are (J,) each: at most 1, and the distance of what follows the joint. What hardly moves
        a vertex counts as if it moved one by `MIN_JOINT_REACH`.
        """
        skeleton, count = self._skeleton, len(self._skeleton.parents)
        entries = self._weights.tocoo()
        arms = self.vertices[entries.row] - self._bind_places[entries.col]
        moves, turns = np.zeros(count), np.zeros(count)
        numbers = skeleton.lead + entries.col
        np.maximum.at(moves, numbers, entries.data)
        np.maximum.at(turns, numbers, entries.data * np.linalg.norm(arms, axis=1))
        reach = np.zeros(count)
        np.maximum.at(reach, numbers, np.linalg.norm(arms, axis=1))
        for j in range(count - 1, 0, -1):  # what is above moves all that is below
            parent = int(skeleton.parents[j])
            far = reach[j] + np.linalg.norm(skeleton.rest_translations[j])
            reach[parent] = turns[parent] = max(reach[parent], far)
            moves[parent] = 1
        size = float(np.linalg.norm(np.ptp(self.vertices, axis=0)))
        least = MIN_JOINT_REACH * (size or 1.0)
        return np.maximum(moves, MIN_JOINT_REACH), np.maximum(turns, least)

    def _multiply(self, values: Floats) -> Floats:
        """Return the weights times values of the joints, (k, n, 3), as (m, 3k)."""
        return np.asarray(self._weights @ values.swapaxes(0, 1).reshape(values.shape[1], -1))


def measure_change(
    keys: JointKeys, read_written: ReadFrames, exact: PosedSkin, written: PosedSkin
) -> tuple[float, float]:
    """Return the rms and the largest distance between two skins, in the unit of the scene.

    One is exact, and posed by the keys of all frames; the other by what `read_written` returns.
    """
    squares = largest = 0.0
    for start in range(0, keys.frame_count, FRAMES_PER_BLOCK):
        stop = min(start + FRAMES_PER_BLOCK, keys.frame_count)
        apart = written.pose(*read_written(start, stop)) - exact.pose(
            *keys.read_frames(start, stop)
        )
        distances = np.square(apart).sum(axis=2)
        squares += float(distances.sum())
        largest = max(largest, float(distances.max()))
    count = keys.frame_count * len(exact.vertices)
    return float(np.sqrt(squares / count)), float(np.sqrt(largest))
