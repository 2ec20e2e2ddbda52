"""Normals of polygons and of their corners, recomputed for any positions."""

import numpy as np

from cageik_cli.geometry.surface_attributes import SurfaceAttributes
from cageik_cli.util.arrays import Floats, Integers

FALLBACK_NORMAL = (0.0, 0.0, 1.0)
"""The normal where faces have no area."""


def compute_fan_normals(attributes: SurfaceAttributes, positions: Floats) -> Floats:
    """Compute the normals that a mesh was given, at other positions.

    A normal is the mean of those of the faces at its corners, weighted by their areas. Faces that
    shared a normal at a vertex share one, so soft and hard edges stay what they were.

    Parameters
    ----------
    attributes : SurfaceAttributes
        With `normal_fans`.
    positions : (n, 3)

    Returns
    -------
    (u, 3), of length 1, for u numbers of fans.
    """
    fans = attributes.normal_fans
    assert fans is not None
    areas = np.repeat(compute_area_vectors(attributes, positions), attributes.corner_counts, axis=0)
    is_given = fans >= 0
    count = int(fans.max(initial=-1)) + 1
    columns = (np.bincount(fans[is_given], areas[is_given, k], minlength=count) for k in range(3))
    sums = np.stack(list(columns), axis=1, dtype=np.float64)
    return _normalize(sums)


def compute_corner_normals(attributes: SurfaceAttributes, positions: Floats) -> Floats:
    """Compute the normal of every corner, (c, 3), of length 1.

    A corner without one has that of its face. Parameters are those of `compute_fan_normals`.
    """
    fans = attributes.normal_fans
    assert fans is not None
    normals = compute_fan_normals(attributes, positions)[fans]
    is_bare = fans < 0
    if is_bare.any():
        faces = _normalize(compute_area_vectors(attributes, positions))
        normals[is_bare] = np.repeat(faces, attributes.corner_counts, axis=0)[is_bare]
    return normals


def has_vertex_normals(attributes: SurfaceAttributes) -> bool:
    """Return whether every corner has a normal, and all corners of a vertex the same."""
    fans = attributes.normal_fans
    if fans is None or (fans < 0).any():
        return False
    pairs = np.stack([attributes.corners, fans], axis=1)
    return len(np.unique(pairs, axis=0)) == len(np.unique(attributes.corners))


def compute_area_vectors(attributes: SurfaceAttributes, positions: Floats) -> Floats:
    """Compute twice the area vector of each polygon, (p, 3), by Newell's formula."""
    counts, starts, corners = attributes.corner_counts, attributes.starts, attributes.corners
    # From its first corner, so that a model far from the origin loses no digits.
    points = positions[corners] - np.repeat(positions[corners[starts]], counts, axis=0)
    return np.asarray(np.add.reduceat(np.cross(points, points[_next_corners(counts)]), starts))


def _next_corners(counts: Integers) -> Integers:
    """Return the place of the corner after each, in its polygon."""
    places = np.arange(1, int(counts.sum()) + 1)
    ends = np.cumsum(counts)
    places[ends - 1] = ends - counts
    return places


def _normalize(vectors: Floats) -> Floats:
    largest = np.abs(vectors).max(axis=1, initial=0, keepdims=True)  # squares of tiny ones vanish
    scaled = np.divide(vectors, largest, out=np.zeros_like(vectors), where=largest > 0)
    lengths = np.linalg.norm(scaled, axis=1, keepdims=True)
    fallback = np.broadcast_to(FALLBACK_NORMAL, vectors.shape)
    return np.asarray(np.divide(scaled, lengths, out=fallback.copy(), where=lengths > 0))
