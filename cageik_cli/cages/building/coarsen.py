"""Collapse edges of a cage one by one, each tested, cheapest by quadrics first."""

import numpy as np

from cageik_cli.cages.building.draft import Draft, Edit
from cageik_cli.cages.building.edits import collapse_edge, settle
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers

LARGEST_VALENCE = 10
"""Edges at a vertex, at most, after a collapse."""

SMALLEST_ANGLE = 8.0
"""Degrees that new faces keep, unless the old ones had less."""

TRIED = 60
"""Edges tried for one collapse, the cheapest first."""


def coarsen(draft: Draft, count: int) -> bool:
    """Collapse edges until the draft has `count` vertices; whether that was reached.

    The quadrics are those of the faces that each vertex has swallowed (Garland and Heckbert 1997),
    so that many small steps do not drift.
    """
    quadrics = vertex_quadrics(TriMesh(draft.vertices, draft.faces))
    here = draft.count
    while here > count:
        ends = TriMesh(draft.vertices, draft.faces).edges.ends
        cost, positions = collapse_costs(quadrics, draft.vertices, ends)
        for edge in np.argsort(cost, kind="stable")[:TRIED]:
            start, stop = map(int, ends[edge])
            if _try_collapse(draft, start, stop, positions[edge]):
                quadrics[start] += quadrics[stop]
                break
        else:
            return False
        here -= 1
    return True


def vertex_quadrics(mesh: TriMesh) -> Floats:
    """Sum over the faces at a vertex of area times p pᵀ, p the plane of the face, (n, 4, 4)."""
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.linalg.norm(normal, axis=1, keepdims=True)
    normal /= np.maximum(double, 1e-300)
    plane = np.concatenate([normal, -(normal * corners[:, 0]).sum(axis=1, keepdims=True)], axis=1)
    quadric = double[:, :, None] / 2 * plane[:, :, None] * plane[:, None]
    quadrics = np.zeros((len(mesh.vertices), 4, 4))
    for k in range(3):
        np.add.at(quadrics, mesh.faces[:, k], quadric)
    return quadrics


def collapse_costs(quadrics: Floats, vertices: Floats, ends: Integers) -> tuple[Floats, Floats]:
    """Cost and best place of every collapse, (e,) and (e, 3)."""
    total = quadrics[ends[:, 0]] + quadrics[ends[:, 1]]
    middle = vertices[ends].mean(axis=1)
    length = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1)
    # Where the planes leave a direction open, the middle decides it.
    size = np.trace(total[:, :3, :3], axis1=1, axis2=2)[:, None, None]
    matrix = total[:, :3, :3] + (1e-3 * size + 1e-30) * np.eye(3)
    side = total[:, :3, 3] + (total[:, :3, :3] @ middle[:, :, None])[:, :, 0]
    step = -np.linalg.solve(matrix, side[:, :, None])[:, :, 0]
    reach = np.linalg.norm(step, axis=1)
    step *= np.minimum(1, length / np.maximum(reach, 1e-300))[:, None]
    places = np.concatenate([middle + step, np.ones((len(ends), 1))], axis=1)
    cost = np.einsum("ei,eij,ej->e", places, total, places)
    return cost + 1e-4 * size.ravel() * length**2, places[:, :3]


def _try_collapse(draft: Draft, start: int, stop: int, position: Floats) -> bool:
    edit = collapse_edge(draft, start, stop, position)
    if edit is None or _valence(edit) > LARGEST_VALENCE:
        return False
    needed = min(SMALLEST_ANGLE, float(draft.angles_before(edit).min()))
    edit = settle(draft, edit)
    return bool(draft.angles(edit).min() >= needed) and draft.take(edit)


def _valence(edit: Edit) -> int:
    """Edges at the vertex that is left."""
    return int((edit.added == edit.vertex).any(axis=1).sum())
