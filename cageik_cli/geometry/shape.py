"""Shape of a surface: areas, angles, Laplacian, degenerate faces, and faces close to others."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

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
