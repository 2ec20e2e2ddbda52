"""The last resort: a convex cage, from planes that the model does not reach."""

import numpy as np
from scipy.spatial import ConvexHull, HalfspaceIntersection

from cageik_cli.cages.building.draft import Draft
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats


def wrap_convex(points: Floats, clearance: float, count: int) -> TriMesh:
    """A convex cage of `count` vertices around points, none nearer than `clearance`.

    Planes in directions spread over the sphere, moved off the points, bound it; three meet in a
    vertex, so that k planes make 2k − 4. The longest edges are then divided.
    """
    planes = max(4, count // 4 + 3)
    directions = _spread_directions(planes)
    reach = (points @ directions.T).max(axis=0) + clearance
    middle = (points.max(axis=0) + points.min(axis=0)) / 2
    halfspaces = np.concatenate([directions, -reach[:, None]], axis=1)
    corners = HalfspaceIntersection(halfspaces, middle).intersections
    corners = corners[np.lexsort(corners.T)]
    hull = ConvexHull(corners)
    used, faces = np.unique(hull.simplices, return_inverse=True)
    faces = faces.reshape(-1, 3)
    corners = corners[used]
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inward = (np.cross(b - a, c - a) * (a - middle)).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return _divide(TriMesh(corners, faces), points, count)


def _spread_directions(count: int) -> Floats:
    """Unit vectors spread evenly over the sphere on a spiral, (count, 3); no two parallel."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    turn = np.pi * (1 + np.sqrt(5)) * k
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)


def _divide(cage: TriMesh, points: Floats, count: int) -> TriMesh:
    """Divide the longest edges until there are `count` vertices."""
    draft = Draft(cage, points, 0.0)
    while draft.count < count:
        ends = TriMesh(draft.vertices, draft.faces).edges.ends
        length = np.linalg.norm(draft.vertices[ends[:, 0]] - draft.vertices[ends[:, 1]], axis=1)
        start, stop = ends[int(length.argmax())]
        draft.split(int(start), int(stop))
    return draft.to_mesh()
