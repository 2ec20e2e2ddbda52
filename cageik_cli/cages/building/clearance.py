"""How near a cage comes to a model anywhere on its faces, not only at chosen points."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import nearest_on_surface
from cageik_cli.util.arrays import Floats

MOST_PIECES = 400_000
"""Pieces of faces looked at in one round, at most."""


@dataclass(frozen=True, slots=True, eq=False)
class Nearness:
    """What is too near to a cage.

    Attributes
    ----------
    clearance : float
        No point of the surface is nearer, units of the positions. Distances above the one asked
        for are not told apart.
    points : (k, 3) float64
        Points of the surface that are nearer than asked for, the nearest first.
    """

    clearance: float
    points: Floats


def find_near_points(
    surface: TriMesh, cage: TriMesh, clearance: float, finest: float
) -> Nearness:
    """Find where a surface is nearer to the cage than `clearance`.

    A distance changes by no more than the way: a piece of a face whose centroid is further away
    than clearance and radius together is done with, the others are cut in four, until their radius
    is `finest` clearances.
    """
    pieces = surface.vertices[surface.faces]
    distance = nearest_on_surface(cage, surface.vertices).distance
    lowest = min(clearance, float(distance.min()))
    found, depths = [surface.vertices[distance < clearance]], [distance[distance < clearance]]
    while len(pieces):
        middle = pieces.mean(axis=1)
        radius = np.linalg.norm(pieces - middle[:, None], axis=2).max(axis=1)
        distance = nearest_on_surface(cage, middle).distance
        bound = distance - radius
        is_near, is_small = distance < clearance, radius < finest * clearance
        found.append(middle[is_near])
        depths.append(distance[is_near])
        divided = ~is_near & ~is_small & (bound < clearance)
        if 4 * np.count_nonzero(divided) > MOST_PIECES:
            divided[:] = False
        pieces = _quartered(pieces[divided])
        sure = np.where(is_near, distance, bound)[~divided]
        lowest = min(lowest, float(sure.min(initial=clearance)))
    order = np.argsort(np.concatenate(depths), kind="stable")
    return Nearness(lowest, np.concatenate(found)[order])


def _quartered(pieces: Floats) -> Floats:
    """Triangles (k, 3, 3) cut in four at the middles of their sides."""
    a, b, c = (pieces[:, k] for k in range(3))
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    return np.concatenate([np.stack(part, axis=1) for part in parts])
