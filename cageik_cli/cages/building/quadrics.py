"""Quadrics: what it costs to move a vertex off the planes of its faces.

Garland and Heckbert 1997.
"""

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import cross
from cageik_cli.util.arrays import Floats, Integers


def vertex_quadrics(mesh: TriMesh) -> Floats:
    """Sum area times p pᵀ over the faces at each vertex, p the plane of the face, (n, 4, 4)."""
    corners = mesh.vertices[mesh.faces]
    normal = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.linalg.norm(normal, axis=1, keepdims=True)
    normal /= np.maximum(double, 1e-300)
    plane = np.concatenate([normal, -(normal * corners[:, 0]).sum(axis=1, keepdims=True)], axis=1)
    quadric = double[:, :, None] / 2 * plane[:, :, None] * plane[:, None]
    quadrics = np.zeros((len(mesh.vertices), 4, 4))
    for k in range(3):
        np.add.at(quadrics, mesh.faces[:, k], quadric)
    return quadrics


def collapse_costs(quadrics: Floats, vertices: Floats, ends: Integers) -> tuple[Floats, Floats]:
    """Return cost and best place of every collapse, (e,) and (e, 3)."""
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
