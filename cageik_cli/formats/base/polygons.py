"""Polygons cut into triangles: as fans, or by clipping ears where a fan would fold over."""

from collections.abc import Sequence
from itertools import chain

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface_attributes import fan_triangulate
from cageik_cli.util.arrays import Floats, Integers

FOLD_TOL = 1e-9
"""A fan is folded when it has a triangle turned against the polygon by more of its area."""


def fan_triangulate_polygons(
    polygons: Sequence[Sequence[int] | Integers],
) -> tuple[Integers, Integers]:
    """Cut `polygons` into fans at their first corners, (f, 3); also return their corner counts.

    Raises
    ------
    InputError
        Naming a polygon of fewer than three corners.
    """
    sizes = np.array([len(polygon) for polygon in polygons], np.int64)
    corners = np.fromiter(chain.from_iterable(polygons), np.int64, sizes.sum())
    return fan_triangulate(corners, sizes), sizes


def replace_folded_fans(mesh: TriMesh) -> TriMesh:
    """Cut the polygons again whose fans fold over, by clipping ears.

    Ears are found in the plane of the polygon's area vector (Newell); a polygon that crosses
    itself and has none keeps its fan. A polygon's triangles stay where its fan was.
    """
    if mesh.attributes is None:
        return mesh
    counts = mesh.attributes.corner_counts - 2
    starts = np.cumsum(counts) - counts
    a, b, c = (mesh.vertices[corner] for corner in mesh.faces.T)
    areas = np.cross(b - a, c - a)
    whole = np.add.reduceat(areas, starts)
    turned = np.einsum("fx,fx->f", areas, np.repeat(whole, counts, axis=0))
    folded = turned < -FOLD_TOL * np.repeat(np.einsum("px,px->p", whole, whole), counts)
    if not folded.any():
        return mesh
    faces = mesh.faces.copy()
    for k in np.unique(mesh.attributes.triangle_polygons[folded]):
        fan = slice(starts[k], starts[k] + counts[k])
        ring = np.concatenate([faces[fan][0, :2], faces[fan][:, 2]])
        ears = _clip_ears(_project_to_plane(mesh.vertices[ring], whole[k]))
        if ears is not None:
            faces[fan] = ring[ears]
    return TriMesh(mesh.vertices, faces, mesh.attributes)


def _project_to_plane(points: Floats, normal: Floats) -> Floats:
    """Project points (k, 3) along `normal`, (k, 2); counter-clockwise seen against it."""
    direction = normal / np.abs(normal).max()  # first, since tiny squares would be zeros
    direction /= np.linalg.norm(direction)
    across = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    across /= np.linalg.norm(across)
    return np.asarray((points - points[0]) @ np.stack([across, np.cross(direction, across)]).T)


def _clip_ears(points: Floats) -> list[list[int]] | None:
    """Return the triangles of a polygon (k, 2), by clipping ears; None if it has no ear."""
    ring, ears = list(range(len(points))), []
    while len(ring) > 3:
        triples = zip(ring[-1:] + ring[:-1], ring, ring[1:] + ring[:1], strict=True)
        ear = next((list(t) for t in triples if _is_ear(points[list(t)], points[ring])), None)
        if ear is None:
            return None
        ears.append(ear)
        ring.remove(ear[1])
    return [*ears, ring]


def _is_ear(triangle: Floats, ring: Floats) -> bool:
    """Return whether a triangle turns left and holds no corner of the ring but its own."""
    sides = np.roll(triangle, -1, axis=0) - triangle
    steps = ring[:, None] - triangle
    lefts = sides[:, 0] * steps[..., 1] - sides[:, 1] * steps[..., 0]
    own = (ring[:, None] == triangle).all(axis=2).any(axis=1)
    turn = sides[0, 0] * sides[1, 1] - sides[0, 1] * sides[1, 0]
    return bool(turn > 0 and not ((lefts >= 0).all(axis=1) & ~own).any())
