"""Normals of polygons and of their corners, recomputed for any positions."""

from dataclasses import replace

import numpy as np

from cageik_cli.geometry.attributes import SurfaceAttributes
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import cross
from cageik_cli.util.arrays import Floats, Integers

FALLBACK_NORMAL = (0.0, 0.0, 1.0)
"""The normal where faces have no area."""

CANCELLED_TOL = 1e-6
"""Area vectors cancel if their sum is at most this share of the sum of their sizes."""


def compute_fan_normals(attributes: SurfaceAttributes, positions: Floats) -> Floats:
    """Compute the normals that a mesh was given, at other positions.

    A normal is the mean of those of the faces at its corners, weighted by their areas. Faces that
    shared a normal at a vertex share one, so soft and hard edges stay what they were. For positions
    (n, 3) and u numbers of fans, they are (u, 3), of length 1.
    """
    fans = attributes.normal_fans
    assert fans is not None
    areas = compute_area_vectors(attributes, positions)
    return _normalize(_sum_at_corners(attributes, fans, int(fans.max(initial=-1)) + 1, areas))


def compute_corner_normals(attributes: SurfaceAttributes, positions: Floats) -> Floats:
    """Compute the normal of every corner, (c, 3), of length 1.

    A corner without one has that of its face.
    """
    complete = complete_fans(attributes)
    assert complete.normal_fans is not None
    return compute_fan_normals(complete, positions)[complete.normal_fans]


def compute_vertex_normals(attributes: SurfaceAttributes, positions: Floats) -> Floats:
    """Compute one normal per vertex, (n, 3), of length 1, as if all its faces shared it.

    It is zero where the area vectors of the faces cancel, as on a surface whose faces are there in
    both windings: their sum is rounding, and has no direction. What is written needs another.
    """
    corners, areas = attributes.corners, compute_area_vectors(attributes, positions)
    count = len(positions)
    sums = _sum_at_corners(attributes, corners, count, areas)
    sizes = _sum_at_corners(attributes, corners, count, _size(areas))
    return np.where(_size(sums) <= CANCELLED_TOL * sizes, 0.0, _normalize(sums))


def shade_smoothly(mesh: TriMesh) -> TriMesh:
    """Return a mesh with normals: its own, or of one fan per vertex if it was given none."""
    attributes = mesh.polygons
    if attributes.normal_fans is not None:
        return mesh
    _, fans = np.unique(attributes.corners, return_inverse=True)
    return TriMesh(mesh.vertices, mesh.faces, replace(attributes, normal_fans=fans))


def complete_fans(attributes: SurfaceAttributes) -> SurfaceAttributes:
    """Return attributes whose corners without a normal have one of their own: of their face."""
    fans = attributes.normal_fans
    assert fans is not None
    own = int(fans.max(initial=-1)) + 1 + np.arange(len(fans))
    _, numbers = np.unique(np.where(fans < 0, own, fans), return_inverse=True)
    return replace(attributes, normal_fans=numbers)


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
    if (counts == 3).all():  # the same to the bit, in a fifth of the time
        first, second, third = (positions[corners[k::3]] for k in range(3))
        return cross(second - first, third - first)
    # From its first corner, so that a model far from the origin loses no digits.
    points = positions[corners] - np.repeat(positions[corners[starts]], counts, axis=0)
    return np.asarray(np.add.reduceat(np.cross(points, points[find_next_corners(counts)]), starts))


def _sum_at_corners(
    attributes: SurfaceAttributes, numbers: Integers, count: int, values: Floats
) -> Floats:
    """Sum values of polygons, (p, a), over the corners that have each number, (count, a).

    Corners have their number in `numbers`, (c,).
    """
    # A corner without a normal counts for one more, which is left out.
    places = np.where(numbers < 0, count, numbers)
    columns = (
        np.bincount(places, np.repeat(along, attributes.corner_counts), count + 1)[:count]
        for along in values.T
    )
    return np.stack(list(columns), axis=1, dtype=np.float64)


def find_next_corners(counts: Integers) -> Integers:
    """Return the place of the corner after each, in its polygon, (c,)."""
    places = np.arange(1, int(counts.sum()) + 1)
    ends = np.cumsum(counts)
    places[ends - 1] = ends - counts
    return places


def _size(vectors: Floats) -> Floats:
    """Return the sums of absolute entries, (n, 1): squares of tiny ones vanish."""
    return np.asarray(np.abs(vectors).sum(axis=1, keepdims=True))


def _normalize(vectors: Floats) -> Floats:
    largest = np.abs(vectors).max(axis=1, initial=0, keepdims=True)  # squares of tiny ones vanish
    scaled = np.divide(vectors, largest, out=np.zeros_like(vectors), where=largest > 0)
    lengths = np.linalg.norm(scaled, axis=1, keepdims=True)
    fallback = np.broadcast_to(FALLBACK_NORMAL, vectors.shape)
    return np.asarray(np.divide(scaled, lengths, out=fallback.copy(), where=lengths > 0))
