"""The smallest sphere that holds some points. Unlike a box, it does not depend on the axes."""

from itertools import combinations

import numpy as np

from cageik_cli.util.arrays import Floats

INSIDE_TOL = 1e-12
"""Relative distance beyond the radius up to which a point is on the sphere."""


def smallest_enclosing_sphere(points: Floats) -> tuple[Floats, float]:
    """Return the centre, (3,), and the radius of the smallest sphere that holds points, (m, 3).

    At most four points determine it. The one furthest outside joins them, and those that determine
    the sphere of these five stay, until none is outside: the radius grows each time, so the exact
    sphere is found after few rounds (Welzl 1991; Gärtner 1999).
    """
    origin = points[0]
    size = float(np.abs(points - origin).max()) or 1.0  # squares of any units must not overflow
    local = (points - origin) / size
    support, centre, radius = local[:1], local[0], 0.0
    while True:
        distances = np.linalg.norm(local - centre, axis=1)
        furthest = int(distances.argmax())
        if distances[furthest] <= radius * (1 + INSIDE_TOL):
            break
        chosen, next_centre, next_radius = _determine_sphere(np.vstack([support, local[furthest]]))
        if next_radius <= radius:  # rounding is all that is left
            radius = float(distances[furthest])
            break
        support, centre, radius = chosen, next_centre, next_radius
    return origin + size * centre, size * radius


def _determine_sphere(points: Floats) -> tuple[Floats, Floats, float]:
    """Return those of at most five points that determine their sphere, its centre and radius.

    Its centre has the smallest distance from the furthest point of all centres.
    """
    best = (points, points[0], np.inf)
    for count in range(2, min(len(points), 4) + 1):
        for numbers in combinations(range(len(points)), count):
            chosen = points[list(numbers)]
            centre = _find_circumcentre(chosen)
            radius = float(np.linalg.norm(points - centre, axis=1).max())
            if radius < best[2]:
                best = (chosen, centre, radius)
    return best


def _find_circumcentre(points: Floats) -> Floats:
    """Return the point in the plane of 2 to 4 points that is equally far from all, (3,).

    Of points that have none, such as three in a row, it is one nearby.
    """
    sides = points[1:] - points[0]
    return np.asarray(points[0] + np.linalg.lstsq(2 * sides, (sides**2).sum(axis=1), rcond=None)[0])
