"""Shape of a surface: areas, normals, angles, Laplacian, degenerate and close faces.

Normals of polygons and of their corners are computed anew for any positions.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cageik_cli.geometry.attributes import SurfaceAttributes
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers

if TYPE_CHECKING:
    from scipy import sparse

MIN_ALTITUDE_RATIO = 1.7453e-7
"""Smallest altitude of a face over its longest side, as of a needle with an angle of 1e-5 degrees.
Below it the face has no plane; the estimate of the error of weights is 3 times too small there."""

NEXT, LAST = np.array([1, 2, 0]), np.array([2, 0, 1])
"""The corner, or the axis, after and before each."""

MAX_SEARCHED_FACES = 256
"""Faces whose opposite faces are searched together."""

FALLBACK_NORMAL = (0.0, 0.0, 1.0)
"""The normal where faces have no area."""

CANCELLED_TOL = 1e-6
"""Area vectors cancel if their sum is at most this share of the sum of their sizes."""


def lumped_areas(mesh: TriMesh) -> Floats:
    """Compute a third of the area of the faces at each vertex, (n,), squared file units."""
    shares = np.repeat(mesh.face_areas / 3, 3)
    areas = np.bincount(mesh.faces.ravel(), shares, minlength=len(mesh.vertices))
    return areas.astype(np.float64)


def cross(a: Floats, b: Floats) -> Floats:
    """Compute cross products over the last axis of arrays of one shape.

    `np.cross` takes five times as long; builders of cages need thousands for a few faces.
    """
    a, b = a.T, b.T
    forward = a.take(NEXT, axis=0) * b.take(LAST, axis=0)
    return np.asarray((forward - a.take(LAST, axis=0) * b.take(NEXT, axis=0)).T)


def corner_angles(mesh: TriMesh) -> Floats:
    """Compute the angle at each corner, (f, 3), degrees; 0 where a side has no length."""
    return measure_angles(mesh.vertices[mesh.faces])


def measure_angles(corner: Floats) -> Floats:
    """Compute the angles of triangles (f, 3, 3), as `corner_angles` does."""
    ahead = corner.take(NEXT, axis=1) - corner
    back = corner.take(LAST, axis=1) - corner
    sine = np.sqrt((cross(ahead, back) ** 2).sum(axis=2))
    return np.asarray(np.degrees(np.arctan2(sine, (ahead * back).sum(axis=2))))


def degenerate_face_mask(mesh: TriMesh) -> NDArray[np.bool_]:
    """Return which faces have no plane, (f,)."""
    corner = mesh.vertices[mesh.faces]
    sides = corner - np.roll(corner, 1, axis=1)
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    return np.asarray(~(2 * mesh.face_areas > MIN_ALTITUDE_RATIO * longest**2), np.bool_)


def bounds_volume(mesh: TriMesh) -> bool:
    """Return whether each edge has two consistently oriented faces: there is an inside."""
    return bool((mesh.edges.face_counts == 2).all() and mesh.is_closed)


def thin_face_pairs(mesh: TriMesh, max_ratio: float) -> tuple[Integers, Floats]:
    """Find pairs of opposite faces that are nearer than `max_ratio` times their width.

    Along the normal through the centroid; the width is the root of the area. No face may be flat.

    Returns
    -------
    (p, 2)
        Each face with one opposite.
    (p,)
        Its distance over the width of the first.
    """
    corner = mesh.vertices[mesh.faces]
    base, one, two = corner[:, 0], corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    width = np.sqrt(mesh.face_areas)
    normal = np.cross(one, two) / (2 * width**2)[:, None]
    # Barycentric coordinates of a point are these gradients times its distance from the base.
    gradients = (np.cross(edge, normal) / (2 * width**2)[:, None] for edge in (two, -one))
    first, second, reach = _find_plane_hits(corner.mean(axis=1), base, normal, max_ratio * width)
    hit = corner.mean(axis=1)[first] + reach[:, None] * normal[first] - base[second]
    u, v = ((hit * gradient[second]).sum(axis=1) for gradient in gradients)
    met = (u >= 0) & (v >= 0) & (u + v <= 1)
    pairs = np.stack([first[met], second[met]], axis=1)
    return pairs, np.abs(reach[met]) / width[pairs[:, 0]]


def _find_plane_hits(
    origin: Floats, base: Floats, normal: Floats, max_distance: Floats
) -> tuple[Integers, Integers, Floats]:
    """Find the planes that each face's normal meets at most `max_distance` away, and where."""
    found = []
    for start in range(0, len(base), MAX_SEARCHED_FACES):
        own = np.arange(start, min(start + MAX_SEARCHED_FACES, len(base)))
        along = normal[own] @ normal.T
        height = (base * normal).sum(axis=1) - origin[own] @ normal.T
        near = np.abs(height) <= max_distance[own, None] * np.abs(along)
        near[np.arange(len(own)), own] = False
        here, other = np.nonzero(near & (np.abs(along) > 1e-12))  # a plane that is not parallel
        found.append((own[here], other, height[here, other] / along[here, other]))
    first, second, reach = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return first, second, reach


def uniform_laplacian(mesh: TriMesh) -> Floats:
    """Build L = I − D⁻¹A of the edges, dense (n, n): position minus the mean of the neighbours.

    Rows sum to zero; `L @ vertices` are the differential coordinates δ (Savoye and Franco 2010,
    section 3; uniform weights do not change when the cage is posed).
    """
    entries, rows, columns = _list_laplacian(mesh)
    laplacian = np.zeros((len(mesh.vertices),) * 2)
    laplacian[rows, columns] = entries
    return laplacian


def sparse_laplacian(mesh: TriMesh) -> "sparse.csr_array":
    """Build the same Laplacian, (n, n), sparse; the row of a lone vertex is zero."""
    from scipy import sparse

    entries, rows, columns = _list_laplacian(mesh)
    return sparse.csr_array((entries, (rows, columns)), shape=(len(mesh.vertices),) * 2)


def _list_laplacian(mesh: TriMesh) -> tuple[Floats, Integers, Integers]:
    """Return the entries of the Laplacian, their rows and their columns; no place comes twice."""
    ends, n = mesh.edges.ends, len(mesh.vertices)
    rows, columns = np.concatenate([ends, ends[:, ::-1]]).T
    degrees = np.bincount(rows, minlength=n)
    entries = np.concatenate([(degrees > 0).astype(np.float64), -1 / degrees[rows]])
    diagonal = np.arange(n)
    return entries, np.concatenate([diagonal, rows]), np.concatenate([diagonal, columns])


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
        # Axis by axis: rows of three numbers take three times as long to read and to multiply.
        a, b, c = (corners[k::3] for k in range(3))
        along = [np.ascontiguousarray(positions[:, axis]) for axis in range(3)]
        start = [axis.take(a) for axis in along]
        one, other = (
            [axis.take(ends) - here for axis, here in zip(along, start, strict=True)]
            for ends in (b, c)
        )
        columns = [
            one[k] * other[last] - one[last] * other[k] for k, last in zip(NEXT, LAST, strict=True)
        ]
        return np.stack(columns, axis=1)
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
    x, y, z = np.abs(vectors).T
    return np.asarray((x + y + z)[:, None])


def _normalize(vectors: Floats) -> Floats:
    x, y, z = np.abs(vectors).T
    largest = np.maximum(np.maximum(x, y), z)[:, None]  # squares of tiny ones vanish
    scaled = np.divide(vectors, largest, out=np.zeros_like(vectors), where=largest > 0)
    x, y, z = np.square(scaled).T
    lengths = np.sqrt(x + y + z)[:, None]
    fallback = np.broadcast_to(FALLBACK_NORMAL, vectors.shape)
    return np.asarray(np.divide(scaled, lengths, out=fallback.copy(), where=lengths > 0))
