"""Whether faces of a cage meet but at what they share, exactly, for a handful of faces."""

import igl
import igl.predicates
import numpy as np

from cageik_cli.geometry.intersections import self_intersections
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers


def are_apart(vertices: Floats, added: Integers, others: Integers) -> bool:
    """Return whether `added` faces meet each other and `others` at shared vertices alone.

    It is exact, and quick for a handful of faces. What is left to `geometry/intersections.py`,
    which has the full answer, is faces that share a plane.
    """
    faces = np.concatenate([added, others])
    corners = vertices[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    count = len(added)
    near = (low[:count, None] <= high).all(axis=2) & (low <= high[:count, None]).all(axis=2)
    near &= np.arange(count)[:, None] < np.arange(len(faces))
    first, second = np.nonzero(near)
    shared = (faces[first][:, :, None] == faces[second][:, None]).any(axis=2).sum(axis=1)
    return not (
        (shared == 3).any()
        or _any_folds_flat(vertices, faces, first[shared == 2], second[shared == 2])
        or _any_pierces(vertices, faces, first[shared < 2], second[shared < 2])
    )


def _any_folds_flat(vertices: Floats, faces: Integers, first: Integers, second: Integers) -> bool:
    """Return whether faces that share a side lie in a plane, on one side of it."""
    a, b = vertices[faces[first]], faces[second]
    alone = ~(b[:, :, None] == faces[first][:, None]).any(axis=2)
    tip = vertices[b[alone]]
    flat = _orient(a[:, 0], a[:, 1], a[:, 2], tip) == 0
    if not flat.any():
        return False
    normal = [np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]) for t in (a[flat], vertices[b[flat]])]
    return bool(((normal[0] * normal[1]).sum(axis=1) <= 0).any())


def _any_pierces(vertices: Floats, faces: Integers, first: Integers, second: Integers) -> bool:
    """Return whether a side of one face meets the other, away from vertices that both have."""
    sides, triangles = [], []
    for one, other in ((faces[first], faces[second]), (faces[second], faces[first])):
        for k in range(3):
            side = one[:, [k, k - 1]]
            free = ~(side[:, :, None] == other[:, None]).any(axis=(1, 2))
            sides.append(side[free])
            triangles.append(other[free])
    p, q = (vertices[np.concatenate(sides)[:, k]] for k in range(2))
    a, b, c = (vertices[np.concatenate(triangles)[:, k]] for k in range(3))
    before, behind = _orient(a, b, c, p), _orient(a, b, c, q)
    doubtful = before * behind <= 0
    if not doubtful.any():
        return False
    if ((before == 0) & (behind == 0)).any():
        return _any_meets(vertices, faces[first], faces[second])
    p, q, a, b, c = (points[doubtful] for points in (p, q, a, b, c))
    turns = np.stack([_orient(p, q, *pair) for pair in ((a, b), (b, c), (c, a))])
    return bool(((turns.min(axis=0) >= 0) | (turns.max(axis=0) <= 0)).any())


def _any_meets(vertices: Floats, first: Integers, second: Integers) -> bool:
    """Return whether pairs of faces, (k, 3) each, meet improperly; also if they share a plane."""
    both, number = np.unique(np.concatenate([first, second]), axis=0, return_inverse=True)
    used, local = np.unique(both, return_inverse=True)
    pairs = self_intersections(TriMesh(vertices[used], local.reshape(-1, 3)))
    asked = np.sort(number.reshape(2, -1).T)
    return bool((pairs[:, None] == asked).all(axis=2).any())


def _orient(a: Floats, b: Floats, c: Floats, d: Floats) -> Integers:
    """Return the sign of the volume of tetrahedra, (k,); exact (Shewchuk 1997)."""
    if len(a) == 0:
        return np.empty(0, np.int64)
    rows = (np.ascontiguousarray(points) for points in (a, b, c, d))
    return np.asarray(igl.predicates.orient3d(*rows), np.int64)
