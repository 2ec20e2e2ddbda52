"""Points all over the surface of a model, which a cage must hold."""

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats

SPACING = 0.015
"""Points on faces that are larger lie no further apart than this, in diagonals."""

MAX_SAMPLES = 60_000
"""They lie further apart when there would be more, the vertices aside."""


def sample_surface(model: TriMesh) -> Floats:
    """The vertices of a model, and points on its large faces, (s, 3)."""
    corners = model.vertices[model.faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = float(np.linalg.norm(normals, axis=1).sum()) / 2
    spacing = max(SPACING * model.diagonal, float(np.sqrt(area / MAX_SAMPLES)))
    parts = np.ceil(np.minimum(sides / spacing, MAX_SAMPLES**0.5)).astype(np.int64)
    points = [model.vertices]
    for count in np.unique(parts[parts > 1]).tolist():
        points.append(divide_triangles(corners[parts == count], count))
    return np.concatenate(points)


def divide_triangles(corners: Floats, parts: int) -> Floats:
    """Points on triangles (k, 3, 3) whose sides are divided in `parts`, without the corners."""
    i, j = np.divmod(np.arange((parts + 1) ** 2), parts + 1)
    kept = (i + j <= parts) & (np.maximum(np.maximum(i, j), parts - i - j) < parts)
    weights = np.stack([i, j, parts - i - j], axis=1)[kept] / parts
    return np.asarray(np.einsum("pc,kcx->kpx", weights, corners).reshape(-1, 3))
