"""An oracle for meeting triangles: one is cut down by the other, in rational arithmetic."""

from fractions import Fraction
from itertools import combinations

import numpy as np


def common_points(a, b):
    """Corners of what triangles (3, 3) have in common; the second has area. Exact."""
    shape, clip = ([tuple(map(Fraction, p)) for p in np.asarray(t).tolist()] for t in (a, b))
    normal = _cross(_less(clip[1], clip[0]), _less(clip[2], clip[0]))
    shape = _cut(shape, normal, clip[0])
    shape = _cut(shape, tuple(-x for x in normal), clip[0])
    for k in range(3):
        outward = _cross(_less(clip[(k + 1) % 3], clip[k]), normal)
        shape = _cut(shape, outward, clip[k])
    return set(shape)


def meet_improperly(vertices, first, second):
    """Whether two faces have a point in common that is not on what they share."""
    shared = [vertices[v] for v in sorted(set(first.tolist()) & set(second.tolist()))]
    ends = [tuple(map(Fraction, p.tolist())) for p in shared]
    points = common_points(vertices[first], vertices[second])
    return any(not _on(point, ends) for point in points)


def improper_pairs(mesh):
    """Every such pair of faces, by trying all."""
    return [
        [i, j]
        for i, j in combinations(range(len(mesh.faces)), 2)
        if meet_improperly(mesh.vertices, mesh.faces[i], mesh.faces[j])
    ]


def _on(point, ends):
    """Whether a point is on the simplex of up to two ends."""
    if len(ends) < 2:
        return point in ends
    along, reach = _less(ends[1], ends[0]), _less(point, ends[0])
    return not any(_cross(along, reach)) and 0 <= _dot(along, reach) <= _dot(along, along)


def _cut(shape, normal, base):
    """What of a convex polygon lies behind a plane, or on it (Sutherland and Hodgman 1974)."""
    heights = [_dot(normal, _less(point, base)) for point in shape]
    kept = []
    for k, (point, height) in enumerate(zip(shape, heights, strict=True)):
        after, beyond = shape[(k + 1) % len(shape)], heights[(k + 1) % len(shape)]
        if height <= 0:
            kept.append(point)
        if height * beyond < 0:
            share = height / (height - beyond)
            kept.append(tuple(x + share * (y - x) for x, y in zip(point, after, strict=True)))
    return kept


def _less(a, b):
    return tuple(x - y for x, y in zip(a, b, strict=True))


def _dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def _cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
