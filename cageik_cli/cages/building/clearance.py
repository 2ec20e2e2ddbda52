"""How near a cage comes to a model anywhere on its faces, not only at chosen points.

Two surfaces that do not cross are nearest to each other at a vertex of one of them, or at an edge
of each: looking at those is enough.
"""

from dataclasses import dataclass

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import closest_points
from cageik_cli.util.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Nearness:
    """The points of a surface that are near to a cage.

    Attributes
    ----------
    clearance : float
        Smallest distance, units of the positions; of surfaces that do not cross. Infinite if there
        is none within the limit.
    points : (k, 3) float64
        Points of the surface within the limit: its vertices, and the places on its edges and faces
        that are nearest to the cage's. The nearest come first.
    """

    clearance: float
    points: Floats


def find_near_points(surface: TriMesh, cage: TriMesh, limit: float) -> Nearness:
    """Find where a surface is nearer to the cage than `limit`."""
    of_vertex = closest_points(cage, surface.vertices).distance
    back = closest_points(surface, cage.vertices)
    between, places = _near_edges(surface, cage, of_vertex, limit)
    distance = np.concatenate([of_vertex, back.distance, between])
    points = np.concatenate([surface.vertices, back.position, places])
    order = np.argsort(distance, kind="stable")
    order = order[distance[order] < limit]
    nearest = float(distance[order[0]]) if len(order) else np.inf
    return Nearness(nearest, points[order])


def _near_edges(
    surface: TriMesh, cage: TriMesh, of_vertex: Floats, limit: float
) -> tuple[Floats, Floats]:
    """Return distances of edges below the limit, (k,), and their places on the surface, (k, 3).

    Parameters
    ----------
    of_vertex : (m,)
        Distances of the surface's vertices from the cage.
    """
    ends = surface.edges.ends
    start, stop = surface.vertices[ends[:, 0]], surface.vertices[ends[:, 1]]
    length = np.linalg.norm(stop - start, axis=1)
    # On the way from one end to the other, a distance falls no faster than the way goes on.
    near = (of_vertex[ends].sum(axis=1) - length) / 2 < limit
    start, stop = start[near], stop[near]
    low, high = np.minimum(start, stop) - limit, np.maximum(start, stop) + limit
    found, places = [np.empty(0)], [np.empty((0, 3))]
    for a, b in cage.vertices[cage.edges.ends]:
        meets = ((low <= np.maximum(a, b)) & (high >= np.minimum(a, b))).all(axis=1)
        if meets.any():
            distance, place = segment_distances(start[meets], stop[meets], a, b)
            found.append(distance[distance < limit])
            places.append(place[distance < limit])
    return np.concatenate(found), np.concatenate(places)


def segment_distances(start: Floats, stop: Floats, a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Return distance of segments (k, 3) from the segment a b, and where on them it is.

    Ericson, Real-Time Collision Detection (2005), section 5.1.9.
    """
    along, other, between = stop - start, b - a, start - a
    square = np.maximum((along * along).sum(axis=1), 1e-300)
    other_square = max(float(other @ other), 1e-300)
    mixed, c, f = along @ other, (along * between).sum(axis=1), between @ other
    denominator = square * other_square - mixed**2
    parallel = denominator <= 1e-14 * square * other_square
    safe = np.where(parallel, 1.0, denominator)
    s = np.where(parallel, 0.0, np.clip((mixed * f - c * other_square) / safe, 0, 1))
    t = np.clip((mixed * s + f) / other_square, 0, 1)
    s = np.clip((mixed * t - c) / square, 0, 1)
    place = start + s[:, None] * along
    return np.linalg.norm(place - (a + t[:, None] * other), axis=1), place
