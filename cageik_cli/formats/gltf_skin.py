"""Vertices of a skin as glTF has them: positions, and joints and weights in sets of four."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.skin import SkinWeights
from cageik_cli.formats.gltf_file import read_rounded, round_to
from cageik_cli.util.arrays import Floats

SET_SIZE = 4
"""Joints per vertex in one set of attributes; programs read one set or two."""


class SkinAttributes:
    """Positions and weights as they are written, and the scale and centre that they are coded by.

    A vertex is at `centre + scale * code`. Floats have the scale 1.
    """

    def __init__(self, vertices: NDArray[np.float32], weights: SkinWeights, is_small: bool) -> None:
        self._weights = weights
        self.scale, self.centre = 1.0, np.zeros(3)
        self._positions: NDArray[Any] = vertices
        self._values: NDArray[Any] = weights.values.astype(np.float32)
        if is_small:
            low, high = vertices.min(axis=0).astype(float), vertices.max(axis=0).astype(float)
            self.centre = (low + high) / 2
            self.scale = float((high - low).max() / 2) or 1.0
            self._positions = round_to((vertices - self.centre) / self.scale, np.int16)
            self._values = _round_weights(weights.values)

    def decode(self, joint_count: int) -> tuple[Floats, Any]:
        """Return the positions, (m, 3), and the weights, sparse (m, n), that programs read."""
        positions = self.centre + self.scale * read_rounded(self._positions)
        values = read_rounded(self._values)
        return positions, replace(self._weights, values=values).to_sparse(joint_count)

    def list_arrays(self, lead: int) -> dict[str, NDArray[Any]]:
        """Return positions, and joints and weights (m, 4) of each set; joints begin with `lead`.

        What weighs nothing is of joint 0.
        """
        m, count = self._weights.joints.shape
        joint_count = int(self._weights.joints.max()) + 1 + lead
        kind = np.uint8 if joint_count <= 256 else np.uint16
        joints = np.zeros((m, count + -count % SET_SIZE), kind)
        values = np.zeros(joints.shape, self._values.dtype)
        values[:, :count] = self._values
        joints[:, :count] = np.where(self._values > 0, self._weights.joints + lead, 0)
        arrays = {"POSITION": self._positions}
        for k in range(joints.shape[1] // SET_SIZE):
            columns = slice(SET_SIZE * k, SET_SIZE * (k + 1))
            arrays |= {f"JOINTS_{k}": joints[:, columns], f"WEIGHTS_{k}": values[:, columns]}
        return arrays


def _round_weights(values: Floats) -> NDArray[np.uint16]:
    """Round weights (m, k) to 16 bits whose rows sum to the largest: those next to it go up.

    Eight bits would move a vertex between far joints by more than all else that is rounded.
    """
    most = np.iinfo(np.uint16).max
    scaled = most * values
    found = np.floor(scaled)
    missing = np.rint(most - found.sum(axis=1, keepdims=True)).astype(np.int64)
    ranks = np.argsort(np.argsort(found - scaled, axis=1, kind="stable"), axis=1)
    return np.asarray(found + (ranks < missing)).astype(np.uint16)
