"""Normals of polygons and of their corners, recomputed for any positions."""

from dataclasses import dataclass, replace

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import cross
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
    return _average_normals(attributes, fans, int(fans.max(initial=-1)) + 1, positions)


def compute_corner_normals(attributes: SurfaceAttributes, positions: Floats) -> Floats:
    """Compute the normal of every corner, (c, 3), of length 1.

    A corner without one has that of its face. Parameters are those of `compute_fan_normals`.
    """
    complete = complete_fans(attributes)
    assert complete.normal_fans is not None
    return compute_fan_normals(complete, positions)[complete.normal_fans]


def compute_vertex_normals(attributes: SurfaceAttributes, positions: Floats) -> Floats:
    """Compute one normal per vertex, (n, 3), of length 1, as if all its faces shared it."""
    return _average_normals(attributes, attributes.corners, len(positions), positions)


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


def _average_normals(
    attributes: SurfaceAttributes, numbers: Integers, count: int, positions: Floats
) -> Floats:
    """Compute `count` normals, shared by the corners that have their number in `numbers` (c,)."""
    areas = compute_area_vectors(attributes, positions).T
    # A corner without a normal counts for one more, which is left out.
    places = np.where(numbers < 0, count, numbers)
    columns = (
        np.bincount(places, np.repeat(along, attributes.corner_counts), count + 1)[:count]
        for along in areas
    )
    return _normalize(np.stack(list(columns), axis=1, dtype=np.float64))


def find_next_corners(counts: Integers) -> Integers:
    """Return the place of the corner after each, in its polygon, (c,)."""
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


@dataclass(frozen=True, slots=True, eq=False)
class TriangleAttributes:
    """What a file says of the t triangles of a mesh, corner by corner.

    Attributes
    ----------
    uvs : (t, 3, 2) float64, optional
        With v upward; zero where a corner has none.
    normal_fans : (t, 3) int64, optional
        Which of the normals of the fans that `complete_fans` returns.
    materials : (t,) int64, optional
        Which of the names; `NONE` for a triangle without.
    material_colours : (k, 4) float64, optional
        Linear red, green, blue and opacity of each name.
    """

    uvs: Floats | None = None
    normal_fans: Integers | None = None
    materials: Integers | None = None
    material_names: tuple[str, ...] = ()
    material_colours: Floats | None = None


def cut_attributes(mesh: TriMesh) -> TriangleAttributes:
    """Return the attributes of the triangles of a mesh, in their order."""
    attributes = mesh.attributes
    if attributes is None:
        return TriangleAttributes()
    corners = find_triangle_corners(mesh)
    uvs, labels = attributes.uvs, attributes.materials
    fans = None if attributes.normal_fans is None else complete_fans(attributes).normal_fans
    table = None if uvs is None else np.concatenate([uvs.values, np.zeros((1, 2))])
    return TriangleAttributes(
        # `NONE` is the last of the table.
        uvs=None if uvs is None or table is None else table[uvs.indices[corners]],
        normal_fans=None if fans is None else fans[corners],
        materials=None if labels is None else labels.indices[attributes.triangle_polygons],
        material_names=() if labels is None else labels.names,
        material_colours=attributes.material_colours,
    )


def find_triangle_corners(mesh: TriMesh) -> Integers:
    """Find the corners of the polygons that the corners of the triangles are, (t, 3).

    The mesh has attributes. A polygon that has a vertex twice gives the first of its corners there.
    """
    attributes = mesh.attributes
    assert attributes is not None
    size = len(mesh.vertices)
    polygons = np.repeat(np.arange(len(attributes.corner_counts)), attributes.corner_counts)
    keys = polygons * size + attributes.corners
    order = np.argsort(keys, kind="stable")
    wanted = attributes.triangle_polygons[:, None] * size + mesh.faces
    return np.asarray(order[np.searchsorted(keys[order], wanted)])
