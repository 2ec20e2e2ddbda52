"""Small holes of a cage: their loops, and the faces that close them."""

from itertools import pairwise

import numpy as np

from cageik_cli.cages.repairing.polygon_mesh import PolygonMesh
from cageik_cli.cages.repairing.tidy import count_edge_uses
from cageik_cli.util.arrays import Floats, Integers


def find_holes(mesh: PolygonMesh) -> list[Integers]:
    """Return the loops of open edges, each turned as the face that would close it.

    Loops that pass a vertex twice are left out.
    """
    uses, _ = count_edge_uses(mesh)
    starts, stops = mesh.next_corners[uses == 1], mesh.corners[uses == 1]
    departures, arrivals = (np.bincount(v, minlength=len(mesh.vertices)) for v in (starts, stops))
    follow = dict(zip(starts.tolist(), stops.tolist(), strict=True))
    simple = (departures == 1) & (arrivals == 1)
    loops = []
    for start in np.flatnonzero(simple).tolist():
        loop = [start]
        while (after := follow.get(loop[-1])) is not None and simple[after] and after != start:
            loop.append(after)
        for vertex in loop:
            simple[vertex] = False
        if follow.get(loop[-1]) == start:
            loops.append(np.array(loop, np.int64))
    return loops


def close_hole(mesh: PolygonMesh, loop: Integers) -> PolygonMesh:
    """Add the faces of least area over a loop: a quad as one face in cages that have quads."""
    if len(loop) == 4 and (mesh.corner_counts == 4).any():
        added = [loop]
    else:
        added = list(loop[_fill_polygon(mesh.vertices[loop])])
    closed = PolygonMesh.from_rings(mesh.vertices, [*mesh.rings, *added])
    return closed.unfold() if len(loop) == 4 else closed


def _fill_polygon(points: Floats) -> Integers:
    """Return the triangles of least area over a polygon (k, 3): numbers of corners, (k − 2, 3).

    Dynamic programming over its chords, Barequet and Sharir 1995.
    """
    count = len(points)
    cost = np.zeros((count, count))
    middle = np.zeros((count, count), np.int64)
    for width in range(2, count):
        for i in range(count - width):
            k = i + width
            j = np.arange(i + 1, k)
            area = np.linalg.norm(np.cross(points[j] - points[i], points[k] - points[i]), axis=1)
            total = cost[i, j] + cost[j, k] + area
            cost[i, k], middle[i, k] = total.min(), j[total.argmin()]
    return np.array(_list_triangles(middle, 0, count - 1), np.int64)


def _list_triangles(middle: Integers, i: int, k: int) -> list[list[int]]:
    if k - i < 2:
        return []
    j = int(middle[i, k])
    below = [t for low, high in pairwise((i, j, k)) for t in _list_triangles(middle, low, high)]
    return [[i, j, k], *below]
