"""Join the parts of a body on a grid by the shortest bridges between them."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from cageik_cli.cages.building.distance_grid import DistanceGrid
from cageik_cli.util.arrays import Floats

MOST_PARTS = 400
"""Parts that are joined, at most: joining them takes the square of their number."""


def find_bridges(grid: DistanceGrid, body: NDArray[np.bool_]) -> Floats | None:
    """Return segments (b, 2, 3) that make one part of a body's parts, of the least total length.

    None when there is nothing to join, or too much.
    """
    parts, count = ndimage.label(body)
    if not 1 <= count <= MOST_PARTS:
        return None
    surface = body & ~ndimage.binary_erosion(body)
    nodes = np.argwhere(surface)
    of_node = parts[tuple(nodes.T)]
    return _spanning_tree([grid.positions(nodes[of_node == part]) for part in range(1, count + 1)])


def _spanning_tree(parts: list[Floats]) -> Floats:
    """Return the tree of shortest segments between sets of points (Prim 1957)."""
    nearest = np.full(len(parts), np.inf)
    segments = np.zeros((len(parts), 2, 3))
    left = np.arange(len(parts)) > 0
    last, found = 0, []
    while left.any():
        tree = cKDTree(parts[last])
        for k in np.flatnonzero(left):
            distance, at = tree.query(parts[k], distance_upper_bound=nearest[k])
            best = int(distance.argmin())
            if distance[best] < nearest[k]:
                nearest[k] = distance[best]
                segments[k] = parts[last][at[best]], parts[k][best]
        last = int(np.where(left, nearest, np.inf).argmin())
        left[last] = False
        found.append(segments[last])
    return np.array(found).reshape(-1, 2, 3)


def measure_segment_distance(grid: DistanceGrid, segments: Floats, reach: float) -> Floats:
    """Return the distance of every node from the nearest segment.

    It is exact up to `reach`; nodes further from all segments may have infinity.
    """
    nearest = np.full(grid.distance.shape, np.inf)
    for start, stop in segments:
        low, high = np.minimum(start, stop) - reach, np.maximum(start, stop) + reach
        first = np.maximum(np.ceil((low - grid.origin) / grid.cell), 0).astype(np.int64)
        last = np.floor((high - grid.origin) / grid.cell).astype(np.int64)
        box = nearest[tuple(slice(a, b + 1) for a, b in zip(first, last, strict=True))]
        nodes = grid.positions(np.indices(box.shape).reshape(3, -1).T + first)
        along = stop - start
        share = np.clip((nodes - start) @ along / max(float(along @ along), 1e-300), 0, 1)
        apart = np.linalg.norm(nodes - start - share[:, None] * along, axis=1)
        np.minimum(box, apart.reshape(box.shape), out=box)
    return nearest
