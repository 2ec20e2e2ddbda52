"""A coarser mesh of some of a mesh's own vertices, for models that are too large to draw."""

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers


def decimate(mesh: TriMesh, max_vertices: int) -> tuple[Integers, Integers]:
    """Keep at most `max_vertices` vertices of a mesh, one per cell of a grid.

    Vertices are not moved, so that weights of the mesh are weights of the coarse one. Faces of
    which two corners fall together are left out. Vertices that no face uses are left out too.

    Returns
    -------
    vertices : (k,) int64
        Their numbers in the mesh, ascending.
    faces : (t, 3) int64
        Indices into `vertices`.
    """
    used = np.unique(mesh.faces)
    if len(used) <= max_vertices:
        return used, np.searchsorted(used, mesh.faces)
    points = mesh.vertices[used]
    points = (points - points.min(axis=0)) / (mesh.diagonal or 1.0)
    size = 1 / np.sqrt(max_vertices)  # too small: a surface of m cells of this size is that large
    cells = _find_cells(points, size)
    while cells.max() >= max_vertices:
        size *= 1.1
        cells = _find_cells(points, size)
    chosen = _choose_vertices(points, cells)
    corners = cells[np.searchsorted(used, mesh.faces)]
    is_kept = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    # Faces are turned so that the smallest corner is first: the same face is then kept once.
    kept = corners[is_kept]
    turned = np.take_along_axis(kept, (kept.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    order = np.argsort(used[chosen])
    number = np.empty(len(order), np.int64)
    number[order] = np.arange(len(order))
    return used[chosen[order]], number[np.unique(turned, axis=0)].reshape(-1, 3)


def _find_cells(points: Floats, size: float) -> Integers:
    """Return the number of each point's cell, counted from 0 without gaps."""
    places = np.floor(points / size).astype(np.int64)
    width = places.max() + 1
    keys = (places[:, 0] * width + places[:, 1]) * width + places[:, 2]
    return np.asarray(np.unique(keys, return_inverse=True)[1].reshape(-1))


def _choose_vertices(points: Floats, cells: Integers) -> Integers:
    """Return the point of each cell that is closest to the mean of its points."""
    counts = np.bincount(cells)
    means = np.stack([np.bincount(cells, weights=axis) for axis in points.T], axis=1)
    distances = np.linalg.norm(points - (means / counts[:, None])[cells], axis=1)
    order = np.lexsort((distances, cells))
    return np.asarray(order[np.searchsorted(cells[order], np.arange(len(counts)))])
