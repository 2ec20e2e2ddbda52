"""Meshes from cages: weights times cages, some frames to a product."""

import numpy as np

from cageik_cli.util.arrays import Floats

GROUP = 4
"""Frames to a product, always: its last digits depend on how many there are."""


def rebuilt(weights: Floats, cages: Floats) -> Floats:
    """The meshes (k, m, 3) that cages (k, n, 3) give by weights (m, n)."""
    meshes = np.empty((len(cages), len(weights), 3))
    for start in range(0, len(cages), GROUP):
        block = cages[start : start + GROUP]
        k, n, _ = block.shape
        columns = weights @ block.transpose(1, 0, 2).reshape(n, 3 * k)
        meshes[start : start + k] = columns.reshape(-1, k, 3).transpose(1, 0, 2)
    return meshes
