"""How a surface is shaped: areas, angles, planes, and the sheets that lie opposite each other."""

import numpy as np
from numpy.typing import NDArray

from cageik_cli.mesh import Floats, Integers, TriMesh

THINNEST = 1e-9
"""Smallest altitude of a cage face over its longest side; below it the face has no plane."""

BLOCK = 256
"""Faces looked at together for sheets opposite."""


def face_areas(mesh: TriMesh) -> Floats:
    """The area of each face, (f,), squared file units."""
    corner = mesh.vertices[mesh.faces]
    normals = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return np.asarray(np.linalg.norm(normals, axis=1) / 2)


def corner_angles(mesh: TriMesh) -> Floats:
    """The angle of each corner of each face, (f, 3), degrees; 0 where a side has no length."""
    corner = mesh.vertices[mesh.faces]
    ahead = np.roll(corner, -1, axis=1) - corner
    back = np.roll(corner, 1, axis=1) - corner
    sine = np.linalg.norm(np.cross(ahead, back), axis=2)
    return np.asarray(np.degrees(np.arctan2(sine, (ahead * back).sum(axis=2))))


def is_flat(mesh: TriMesh) -> NDArray[np.bool_]:
    """Which faces have no plane, (f,)."""
    corner = mesh.vertices[mesh.faces]
    sides = corner - np.roll(corner, 1, axis=1)
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    return np.asarray(~(2 * face_areas(mesh) > THINNEST * longest**2), np.bool_)


def bounds_volume(mesh: TriMesh) -> bool:
    """Whether each edge has two faces that turn alike: there is an inside and an outside."""
    return bool((mesh.edges.uses == 2).all() and mesh.is_closed)


def opposite_sheets(mesh: TriMesh) -> tuple[Floats, Integers]:
    """How far the sheet opposite each face is, over the face's width, and which face it is.

    Along the normal through the centroid, inward and outward; the width is the root of the area.

    Returns
    -------
    (f,), infinite where there is none
    (f,)
    """
    corner = mesh.vertices[mesh.faces]
    base, one, two = corner[:, 0], corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    normal = np.cross(one, two)
    twice_area = np.linalg.norm(normal, axis=1, keepdims=True)
    normal /= twice_area
    # Barycentric coordinates of a point are these gradients times its distance from the base.
    gradients = np.cross(two, normal) / twice_area, np.cross(normal, one) / twice_area
    origin = corner.mean(axis=1)
    distance, opposite = np.empty(len(base)), np.empty(len(base), np.int64)
    for start in range(0, len(base), BLOCK):
        chosen = np.arange(start, min(start + BLOCK, len(base)))
        along = normal[chosen] @ normal.T
        along[np.abs(along) < 1e-12] = np.inf  # parallel: it is met nowhere, at distance 0
        reach = ((base * normal).sum(axis=1) - origin[chosen] @ normal.T) / along
        u, v = (
            origin[chosen] @ gradient.T
            - (base * gradient).sum(axis=1)
            + reach * (normal[chosen] @ gradient.T)
            for gradient in gradients
        )
        met = (u >= 0) & (v >= 0) & (u + v <= 1) & np.isfinite(along)
        met[np.arange(len(chosen)), chosen] = False
        reach = np.where(met, np.abs(reach), np.inf)
        distance[chosen], opposite[chosen] = reach.min(axis=1), reach.argmin(axis=1)
    return distance / np.sqrt(twice_area[:, 0] / 2), opposite
