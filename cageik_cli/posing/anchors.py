"""Points on the surface that are to go somewhere: named, picked on a screen, or the nearest.

A point on a triangle is q = Σ_i γ_i v_i over its corners, with barycentric coordinates γ (Savoye
and Franco 2010, eq. 3). The mesh is H c, so the point is Σ_i γ_i H_i c: one row in cage space
(eq. 4).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cageik_cli.geometry.camera import Camera
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import closest_points
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import InputError

BARYCENTRIC_TOL = 1e-6
"""Barycentric coordinates whose sum is off by more are a mistake; up to it, they are divided."""

COINCIDENT_TOL = 1e-9
"""Points nearer to each other than this, in diagonals, are one."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoint:
    """A point on a mesh, wherever that is.

    Attributes
    ----------
    corners : (3,) int64
        Vertices of the face that it is on; all the same for a vertex.
    barycentric : (3,) float64
        γ, of sum one.
    """

    corners: Integers
    barycentric: Floats

    def cage_weights(self, weights: Floats) -> Floats:
        """Σ_i γ_i H_i, (n,): the point in cage space."""
        return np.asarray(self.barycentric @ weights[self.corners])

    def position(self, vertices: Floats) -> Floats:
        """Where it is on meshes of these vertices, (…, m, 3): (…, 3)."""
        return np.asarray(self.barycentric @ vertices[..., self.corners, :])


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """A point of the surface that is held, or moved.

    Attributes
    ----------
    name : str
    point : SurfacePoint
    weight : float
        How much it counts beside other anchors; above 0.
    hard : bool
        Whether it is met exactly; its weight is then not asked for.

    Raises
    ------
    InputError
        When the weight is not a finite number above 0.

    Examples
    --------
    >>> from cageik_cli import Anchor, load_mesh, point_at_vertex
    >>> rest = load_mesh("data_fixtures/walker/frames/walker_1.obj")
    >>> Anchor("hand", point_at_vertex(rest, 1040), hard=True)
    <Anchor: 'hand', hard>
    """

    name: str
    point: SurfacePoint
    weight: float = 1.0
    hard: bool = False

    def __repr__(self) -> str:
        return f"<Anchor: {self.name!r}, {'hard' if self.hard else f'weight {self.weight:g}'}>"

    def __post_init__(self) -> None:
        if not (np.isfinite(self.weight) and self.weight > 0):
            raise InputError(
                f"the weight of {self.name!r} is {self.weight:g}, expected a number above 0"
            )


def anchor_matrix(anchors: Sequence[Anchor], weights: Floats) -> Floats:
    """The anchors in cage space, (l, n), by weights (m, n)."""
    rows = [anchor.point.cage_weights(weights) for anchor in anchors]
    return np.array(rows).reshape(len(rows), weights.shape[1])


def anchor_positions(anchors: Sequence[Anchor], vertices: Floats) -> Floats:
    """Where the anchors are on meshes (…, m, 3): (…, l, 3)."""
    points = [anchor.point.position(vertices) for anchor in anchors]
    return np.stack(points, axis=-2) if points else np.empty((*vertices.shape[:-2], 0, 3))


def point_at_vertex(mesh: TriMesh, vertex: int) -> SurfacePoint:
    """A vertex.

    Raises
    ------
    InputError
        When the mesh has none of that number.

    Examples
    --------
    >>> from cageik_cli import load_mesh, point_at_vertex
    >>> rest = load_mesh("data_fixtures/walker/frames/walker_1.obj")
    >>> bool((point_at_vertex(rest, 1040).position(rest.vertices) == rest.vertices[1040]).all())
    True
    """
    count = len(mesh.vertices)
    if not 0 <= vertex < count:
        raise InputError(
            f"there is no vertex {vertex}; the mesh has {count}, numbered from 0 to {count - 1}"
        )
    return SurfacePoint(np.full(3, vertex), np.array([1.0, 0.0, 0.0]))


def point_on_face(mesh: TriMesh, face: int, barycentric: Floats) -> SurfacePoint:
    """The point of a face that has these barycentric coordinates.

    Raises
    ------
    InputError
        When there is no such face, or the coordinates are not three finite numbers, zero or above,
        whose sum is one.
    """
    count, shares = len(mesh.faces), np.asarray(barycentric, np.float64)
    if not 0 <= face < count:
        raise InputError(
            f"there is no face {face}; the mesh has {count} triangles, numbered from 0 to "
            f"{count - 1}"
        )
    if shares.shape != (3,) or not np.isfinite(shares).all():
        raise InputError("barycentric coordinates are not three finite numbers")
    if abs(shares.sum() - 1) > BARYCENTRIC_TOL:
        raise InputError(f"barycentric coordinates sum to {shares.sum():.10g}, expected 1")
    if shares.min() < -BARYCENTRIC_TOL:
        raise InputError(
            f"a barycentric coordinate is {shares.min():g}, expected 0 or above: the point is "
            "not on the face"
        )
    return SurfacePoint(mesh.faces[face], shares / shares.sum())


def closest_point(mesh: TriMesh, position: Floats) -> SurfacePoint:
    """Return the point of the surface nearest to a position in space, (3,).

    Examples
    --------
    >>> from cageik_cli import closest_point, load_mesh
    >>> rest = load_mesh("data_fixtures/walker/frames/walker_1.obj")
    >>> point = closest_point(rest, rest.vertices[1040])
    >>> bool(abs(point.position(rest.vertices) - rest.vertices[1040]).max() < 1e-9)
    True
    """
    from scipy.optimize import nnls  # a tenth of a second, which few handles files need

    nearest = closest_points(mesh, np.asarray(position, np.float64)[None])
    corners = mesh.faces[nearest.face[0]]
    away = (mesh.vertices[corners] - nearest.position[0]) / (mesh.diagonal or 1.0)
    # Faces without area have points with many coordinates: any that are not negative will do.
    shares, _ = nnls(np.vstack([away.T, np.ones(3)]), np.array([0.0, 0, 0, 1]))
    return SurfacePoint(corners, shares / shares.sum())


def pick(mesh: TriMesh, camera: Camera, pixel: Floats) -> SurfacePoint:
    """The front-most point of the surface that is seen in a pixel, (2,).

    Faces are hit from both sides, and rays do not slip through between two.

    Raises
    ------
    InputError
        When nothing is seen there between the near and the far plane.

    References
    ----------
    Woop, Benthin and Wald 2013, for edge functions that faces share bit for bit.
    """
    rays = camera.cast_rays(np.asarray(pixel, np.float64)[None])
    seen = (mesh.vertices - rays.origins[0]) @ _ray_axes(rays.directions[0]).T
    x, y, depth = (np.ascontiguousarray(column)[mesh.faces].T for column in seen.T)
    edges = np.roll(x, -2, axis=0) * np.roll(y, -1, axis=0)
    edges = np.roll(x, -1, axis=0) * np.roll(y, -2, axis=0) - edges
    area = edges.sum(axis=0)
    is_hit = ((edges >= 0).all(axis=0) | (edges <= 0).all(axis=0)) & (area != 0)
    faces = np.flatnonzero(is_hit)
    shares = edges[:, faces] / area[faces]
    depths = (shares * depth[:, faces]).sum(axis=0)
    is_seen = (depths >= 0) & (depths <= rays.lengths[0])
    if not is_seen.any():
        x_text, y_text = (f"{value:g}" for value in pixel)
        beyond = ", but only before the near or beyond the far plane" if len(faces) else ""
        verb = "meets" if beyond else "misses"
        raise InputError(
            f"pixel ({x_text}, {y_text}) of {camera.width:g} x {camera.height:g} {verb} the mesh"
            f"{beyond}; {_suggest_visible_pixels(mesh, camera)}"
        )
    nearest = int(np.where(is_seen, depths, np.inf).argmin())
    return SurfacePoint(mesh.faces[faces[nearest]], shares[:, nearest])


def _suggest_visible_pixels(mesh: TriMesh, camera: Camera) -> str:
    """What to do about a pixel that shows nothing."""
    try:
        seen = camera.project(mesh.vertices)[:, :2]
    except InputError:
        return (
            "choose one where it is seen, or another camera: some of it is behind this one, whose "
            "view has to take the mesh's own axes and units to the eye"
        )
    (left, upper), (right, lower) = seen.min(axis=0), seen.max(axis=0)
    return f"choose one where it is seen: x {left:.0f} to {right:.0f}, y {upper:.0f} to {lower:.0f}"


def _ray_axes(direction: Floats) -> Floats:
    """Axes, (3, 3), of which the last is `direction`, of length one."""
    start = np.eye(3)[np.abs(direction).argmin()]
    first = np.cross(direction, start)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first), direction])
