"""The last resort: an ellipsoid around the model, drawn in as far as tested moves go."""

import numpy as np
from scipy.spatial import ConvexHull

from cageik_cli.cages.building.draft import Draft
from cageik_cli.cages.building.judge import Demand
from cageik_cli.cages.building.polish import tighten
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers

FLATTEST = 0.3
"""The shortest axis of the ellipsoid over the longest, at least: flatter faces are needles."""

DRAWS = 12
"""Rounds of moves inward."""

ROOM = 1.05
"""Clearances that it keeps."""


def wrap_ellipsoid(demand: Demand, draws: int) -> TriMesh:
    """Return an ellipsoid of as many vertices as are allowed, drawn in `draws` times."""
    low, high = demand.surface.vertices.min(axis=0), demand.surface.vertices.max(axis=0)
    axes = np.maximum(high - low, FLATTEST * (high - low).max()) / 2
    unit, faces = _divide_sphere(demand.most)
    a, b, c = (unit[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    inner = np.min(np.abs((normal * a).sum(axis=1)) / np.linalg.norm(normal, axis=1))
    middle = (low + high) / 2
    room = ROOM * demand.clearance
    reach = np.linalg.norm((demand.surface.vertices - middle) / axes, axis=1).max()
    axes = axes * (reach + room / axes.min()) / inner
    draft = Draft(TriMesh(middle + axes * unit, faces), demand.samples, room)
    for _ in range(draws):
        if tighten(draft, demand.samples) == 0:
            break
    return draft.to_mesh()


def _divide_sphere(count: int) -> tuple[Floats, Integers]:
    """Spread points over the unit sphere on a spiral; return them and their outward faces."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    turn = np.pi * (1 + np.sqrt(5)) * k
    radius = np.sqrt(1 - z**2)
    points = np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)
    faces = ConvexHull(points).simplices.astype(np.int64)
    a, b, c = (points[faces[:, k]] for k in range(3))
    inward = (np.cross(b - a, c - a) * a).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return points, faces
