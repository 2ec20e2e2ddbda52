"""Points all over a surface: its vertices, and points on its large faces."""

from collections.abc import Iterator

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats

MAX_BLOCK_POINTS = 1_000_000
"""Points that are made at once, the vertices aside."""


def sample_surface(surface: TriMesh, spacing: float = 0.015, max_points: int = 60_000) -> Floats:
    """Return the vertices of a surface, and points on faces with longer sides than the spacing.

    Parameters
    ----------
    spacing : float
        Points on a face are no further apart than this, in diagonals.
    max_points : int
        They are further apart where the area has room for more than so many. Needles may have more,
        as they have hardly any area.

    Returns
    -------
    (s, 3), the vertices first.
    """
    return np.concatenate(list(sample_in_blocks(surface, spacing * surface.diagonal, max_points)))


def sample_in_blocks(
    surface: TriMesh, spacing: float = 0.01, max_points: int = 150_000
) -> Iterator[Floats]:
    """Yield the points of `sample_surface` in blocks (k, 3), for meshes with many needles.

    The spacing is in file units: the default is for models whose diagonal is one.
    """
    corners = surface.vertices[surface.faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    spacing = find_spacing(surface, spacing, max_points)
    parts = np.ceil(np.minimum(sides / spacing, max_points**0.5)).astype(np.int64)
    points = [surface.vertices]
    for count in np.unique(parts[parts > 1]).tolist():
        divided, step = corners[parts == count], max(1, 2 * MAX_BLOCK_POINTS // (count + 2) ** 2)
        for start in range(0, len(divided), step):
            points.append(divide_triangles(divided[start : start + step], count))
            if sum(map(len, points)) >= MAX_BLOCK_POINTS:
                yield np.concatenate(points)
                points = []
    yield np.concatenate([np.empty((0, 3)), *points])


def find_spacing(surface: TriMesh, spacing: float = 0.01, max_points: int = 150_000) -> float:
    """Return how far apart the points of `sample_in_blocks` are on a face, at most."""
    return max(spacing, float(np.sqrt(surface.face_areas.sum() / max_points)))


def divide_triangles(corners: Floats, parts: int) -> Floats:
    """Return points on triangles (k, 3, 3) with sides divided in `parts`, without the corners."""
    i, j = np.divmod(np.arange((parts + 1) ** 2), parts + 1)
    kept = (i + j <= parts) & (np.maximum(np.maximum(i, j), parts - i - j) < parts)
    weights = np.stack([i, j, parts - i - j], axis=1)[kept] / parts
    return np.asarray(np.einsum("pc,kcx->kpx", weights, corners).reshape(-1, 3))


def take_evenly(points: Floats, count: int) -> Floats:
    """Return points at even steps of their numbers, (s, 3), `count` of them at most."""
    return points[:: -(-len(points) // count)]
