"""Intersections of triangles, decided exactly.

Boxes, of many faces in a tree (libigl), find the pairs. Every decision is the sign of the volume of
a tetrahedron, which is exact: where rounding may decide, Shewchuk's predicates do (1997; libigl).
"""

import numpy as np
from numpy.typing import NDArray

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers

Booleans = NDArray[np.bool_]

MAX_COMPARED_FACES = 1000
"""Faces whose boxes are all compared: libigl, with its tree, takes longer to import."""

ORIENTATION_TOL = 7.7715611723761027e-16
"""Largest error of a sum of rounded products, in the sum of their sizes: (7 + 56 ε) ε of
Shewchuk 1997, where ε is half the spacing of numbers at one."""


def self_intersections(mesh: TriMesh, block_size: int = 1 << 16) -> Integers:
    """Find pairs of faces that meet elsewhere than at shared vertices and edges, (p, 2), sorted.

    Faces that only touch are such a pair, and so are neighbours folded flat onto each other. Faces
    on the same three vertices, and faces without area, are not tested. To bound the memory,
    `block_size` pairs are tested together.
    """
    pairs = _find_candidate_pairs(mesh, mesh)
    pairs = _sort_pairs(pairs[pairs[:, 0] < pairs[:, 1]])
    blocks = [pairs[start : start + block_size] for start in range(0, len(pairs), block_size)]
    found = [block[_meet_improperly(mesh, block)] for block in blocks]
    return np.concatenate([np.empty((0, 2), np.int64), *found])


def crossing_face_pairs(first: TriMesh, second: TriMesh, min_depth: float) -> Integers:
    """Find pairs of a face of `first` and one of `second` that pass through each other, (p, 2).

    Each has corners on both sides of the other's plane, and they share a segment, all by more than
    `min_depth` (file units): faces that only touch, up to rounding, do not count.
    """
    pairs = _sort_pairs(_find_candidate_pairs(first, second))
    a = first.vertices[first.faces[pairs[:, 0]]]
    b = second.vertices[second.faces[pairs[:, 1]]]
    chosen = _straddle_planes(a, b, min_depth) & _straddle_planes(b, a, min_depth)
    chosen[chosen] = _common_length(a[chosen], b[chosen]) > min_depth
    return pairs[chosen]


def _meet_improperly(mesh: TriMesh, pairs: Integers) -> Booleans:
    a, b = (mesh.faces[pairs[:, k]] for k in range(2))
    a, b = _put_shared_first(a, b), _put_shared_first(b, a)
    shared = (a == b).cumprod(axis=1).sum(axis=1)
    found = np.zeros(len(pairs), bool)
    for count, meet in enumerate((triangles_meet, _meet_away_from_corner, _are_folded_together)):
        chosen = shared == count
        found[chosen] = meet(mesh.vertices[a[chosen]], mesh.vertices[b[chosen]])
    return found


def triangles_meet(a: Floats, b: Floats) -> Booleans:
    """Return whether triangles (k, 3, 3) have a common point, (k,); exact.

    If they have, an edge of one meets the other.
    """
    found = np.zeros(len(a), bool)
    for side in range(3):
        found |= segments_meet(a[:, side], a[:, side - 1], b)
        found |= segments_meet(b[:, side], b[:, side - 1], a)
    return found


def segments_meet(start: Floats, stop: Floats, triangle: Floats) -> Booleans:
    """Return whether segments, (k, 3) each, meet triangles (k, 3, 3); exact.

    Nothing meets a triangle without area.
    """
    a, b, c = (triangle[:, k] for k in range(3))
    before, behind = _side_of_plane(a, b, c, start), _side_of_plane(a, b, c, stop)
    found = before * behind <= 0
    within = (before == 0) & (behind == 0)
    if within.any():  # rare, and slow even for none
        found[within] = _meet_in_plane(start[within], stop[within], triangle[within])
    through = found & ~within
    p, q, a, b, c = (points[through] for points in (start, stop, a, b, c))
    turns = np.stack([_side_of_plane(p, q, *side) for side in ((a, b), (b, c), (c, a))])
    found[through] = (turns.min(axis=0) >= 0) | (turns.max(axis=0) <= 0)
    return np.asarray(found, np.bool_)


def _meet_away_from_corner(a: Floats, b: Floats) -> Booleans:
    """Return whether triangles that share their first corner meet elsewhere.

    A ray from the corner that stays in both leaves one of them through the opposite side.
    """
    return np.asarray(
        segments_meet(a[:, 1], a[:, 2], b) | segments_meet(b[:, 1], b[:, 2], a), np.bool_
    )


def _are_folded_together(a: Floats, b: Floats) -> Booleans:
    """Return whether triangles that share their first two corners are folded onto each other."""
    found = _side_of_plane(a[:, 0], a[:, 1], a[:, 2], b[:, 2]) == 0
    if found.any():
        a, b = a[found], b[found]
        same = np.zeros(len(a), bool)
        for axis in range(3):
            here, there = (_turning_direction(t[:, 0], t[:, 1], t[:, 2], axis) for t in (a, b))
            same |= here * there > 0
        found[found] = same
    return np.asarray(found, np.bool_)


def _meet_in_plane(start: Floats, stop: Floats, triangle: Floats) -> Booleans:
    """Return whether segments meet triangles of the same plane: no line separates them.

    A line that separates two convex shapes can be turned until it contains a side of one.
    """
    a, b, c = (triangle[:, k] for k in range(3))
    found = np.zeros(len(start), bool)
    for axis in range(3):
        around = _turning_direction(a, b, c, axis)
        apart = np.zeros(len(start), bool)
        for p, q in ((a, b), (b, c), (c, a)):
            outside = [around * _turning_direction(p, q, end, axis) < 0 for end in (start, stop)]
            apart |= outside[0] & outside[1]
        corners = np.stack([_turning_direction(start, stop, corner, axis) for corner in (a, b, c)])
        apart |= (corners.min(axis=0) > 0) | (corners.max(axis=0) < 0)
        found |= (around != 0) & ~apart
    return found


def _side_of_plane(a: Floats, b: Floats, c: Floats, point: Floats) -> Integers:
    """Return the side of the plane through a, b, c for each point, (k,): 1, 0, −1; exact."""
    ad, bd, cd = a - point, b - point, c - point
    found, size = np.zeros((2, len(ad)))
    for k in range(3):
        x, y = ad[:, (k + 1) % 3] * bd[:, (k + 2) % 3], ad[:, (k + 2) % 3] * bd[:, (k + 1) % 3]
        found += cd[:, k] * (x - y)
        size += np.abs(cd[:, k]) * (np.abs(x) + np.abs(y))
    side = np.sign(found).astype(np.int64)
    # Written so that what is not finite is doubtful, too.
    doubtful = ~(np.abs(found) > ORIENTATION_TOL * size)
    if doubtful.any():
        import igl.predicates

        rows = [np.ascontiguousarray(p[doubtful]) for p in (a, b, c, point)]
        side[doubtful] = igl.predicates.orient3d(*rows)
    return side


def _turning_direction(a: Floats, b: Floats, c: Floats, axis: int) -> Integers:
    """Return which way a, b, c turn seen along an axis, (k,): 1, 0 or −1; exact."""
    p, q, r = (np.where(np.arange(3) == axis, 0.0, point) for point in (a, b, c))
    return _side_of_plane(p, q, r, p + np.eye(3)[axis])


def _straddle_planes(a: Floats, b: Floats, min_depth: float) -> Booleans:
    """Return whether triangles `a` reach further than `min_depth` on both sides of those `b`."""
    height = _heights(a, b)
    return np.asarray(
        (height.max(axis=1) > min_depth) & (height.min(axis=1) < -min_depth), np.bool_
    )


def _common_length(a: Floats, b: Floats) -> Floats:
    """Return the length of the common segment of triangles that straddle each other, (k,).

    Negative if they meet the line of intersection of their planes in separate places.
    """
    line = np.cross(_unit_normals(a), _unit_normals(b))
    line /= np.maximum(np.linalg.norm(line, axis=1, keepdims=True), np.finfo(float).tiny)
    low, high = np.full(len(a), -np.inf), np.full(len(a), np.inf)
    for one, other in ((a, b), (b, a)):
        height, along = _heights(one, other), np.einsum("kcx,kx->kc", one - a[:, :1], line)
        after, beyond = np.roll(height, -1, axis=1), np.roll(along, -1, axis=1)
        cut = height * after <= 0
        share = np.divide(height, height - after, out=np.zeros_like(height), where=cut)
        place = along + share * (beyond - along)
        low = np.maximum(low, np.where(cut, place, np.inf).min(axis=1))
        high = np.minimum(high, np.where(cut, place, -np.inf).max(axis=1))
    return np.asarray(high - low)


def _heights(a: Floats, b: Floats) -> Floats:
    """Return the heights of the corners of `a` over the planes of `b`, (k, 3); 0 without plane."""
    return np.asarray(np.einsum("kcx,kx->kc", a - b[:, :1], _unit_normals(b)))


def _unit_normals(triangles: Floats) -> Floats:
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.where(length > 0, length, 1))


def _find_candidate_pairs(first: TriMesh, second: TriMesh) -> Integers:
    """Find pairs of faces, (p, 2): at least all that have a common point."""
    if max(len(first.faces), len(second.faces)) <= MAX_COMPARED_FACES:
        corners = [mesh.vertices[mesh.faces] for mesh in (first, second)]
        (low, other_low), (high, other_high) = (
            [bound(corner, axis=1) for corner in corners] for bound in (np.min, np.max)
        )
        meet = np.ones((len(low), len(other_low)), bool)  # whose boxes have a common point
        for k in range(3):
            meet &= low[:, k, None] <= other_high[:, k]
            meet &= other_low[:, k] <= high[:, k, None]
        return np.argwhere(meet)
    import igl.predicates

    _, pairs, _ = igl.predicates.find_intersections(
        first.vertices, first.faces, second.vertices, second.faces
    )
    return np.asarray(pairs, np.int64).reshape(-1, 2)


def _put_shared_first(corners: Integers, others: Integers) -> Integers:
    """Reorder the corners of faces (k, 3): those shared with the other face first, by number."""
    shared = (corners[:, :, None] == others[:, None]).any(axis=2)
    order = np.lexsort((corners, ~shared), axis=1)
    return np.take_along_axis(corners, order, axis=1)


def _sort_pairs(pairs: Integers) -> Integers:
    return pairs[np.lexsort(pairs.T[::-1])]
