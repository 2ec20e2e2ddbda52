"""Anchors: points of the surface that are moved or held, by vertex, face, position or pixel.

A point of a triangle is q = Σ_i γ_i v_i over its corners, with barycentric coordinates γ (Savoye
and Franco 2010, eq. 3). The mesh is H c, so the point is Σ_i γ_i H_i c: one row in cage space
(eq. 4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cageik_cli.geometry.mesh import MAX_COORDINATE, TriMesh
from cageik_cli.geometry.surface import closest_points
from cageik_cli.method.pose.camera import Camera
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.calls import check_call
from cageik_cli.util.errors import HandlesError, InputError
from cageik_cli.util.text import group_digits

BARYCENTRIC_TOL = 1e-6
"""Barycentric coordinates may miss the sum of one by this much; they are then normalised."""

COINCIDENT_TOL = 1e-9
"""Points closer to each other than this, in diagonals, are the same point."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoint:
    """A point of a mesh, which moves with the mesh.

    Attributes
    ----------
    corners : (3,) int64
        Vertices of its face; three times the same one for a point at a vertex.
    barycentric : (3,) float64
        γ; the sum is one.
    """

    corners: Integers
    barycentric: Floats

    def cage_weights(self, weights: Floats) -> Floats:
        """Return the point in cage space, Σ_i γ_i H_i, (n,), for weights (m, n)."""
        return np.asarray(self.barycentric @ weights[self.corners])

    def position(self, vertices: Floats) -> Floats:
        """Return the position on meshes (…, m, 3), as (…, 3)."""
        return np.asarray(self.barycentric @ vertices[..., self.corners, :])


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """A named point of the surface that is moved to a target, or held.

    Attributes
    ----------
    weight : float
        Importance relative to other anchors; above 0.
    hard : bool
        Whether its target is met exactly; the weight is then not used.
    radius : float, optional
        Distance over the surface, in the units of the rest pose, up to which the model moves with
        it where the rest is held; above 0. None chooses one from the model.

    Raises
    ------
    HandlesError
        When the weight or the radius is not a finite number above 0.

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
    radius: float | None = None

    def __repr__(self) -> str:
        return f"<Anchor: {self.name!r}, {'hard' if self.hard else f'weight {self.weight:g}'}>"

    def __post_init__(self) -> None:
        for name, value in (("weight", self.weight), ("radius", self.radius)):
            if value is not None and not (np.isfinite(value) and value > 0):
                raise HandlesError(
                    f"anchor {self.name!r}: {name} is {value:g}, expected a finite number above 0"
                )


def anchor_matrix(anchors: Sequence[Anchor], weights: Floats) -> Floats:
    """Return the anchors in cage space, (l, n), for weights (m, n)."""
    rows = [anchor.point.cage_weights(weights) for anchor in anchors]
    return np.array(rows).reshape(len(rows), weights.shape[1])


def anchor_positions(anchors: Sequence[Anchor], vertices: Floats) -> Floats:
    """Return the positions of the anchors on meshes (…, m, 3), as (…, l, 3)."""
    points = [anchor.point.position(vertices) for anchor in anchors]
    return np.stack(points, axis=-2) if points else np.empty((*vertices.shape[:-2], 0, 3))


@check_call
def point_at_vertex(mesh: TriMesh, vertex: int) -> SurfacePoint:
    """Return the point at a vertex.

    Raises
    ------
    HandlesError
        When the mesh has no vertex of this number.

    Examples
    --------
    >>> from cageik_cli import load_mesh, point_at_vertex
    >>> rest = load_mesh("data_fixtures/walker/frames/walker_1.obj")
    >>> bool((point_at_vertex(rest, 1040).position(rest.vertices) == rest.vertices[1040]).all())
    True
    """
    count = len(mesh.vertices)
    if not 0 <= vertex < count:
        raise HandlesError(
            f"there is no vertex {vertex}; the mesh has {count}, numbered from 0 to {count - 1}"
        )
    return SurfacePoint(np.full(3, vertex), np.array([1.0, 0.0, 0.0]))


def point_on_face(mesh: TriMesh, face: int, barycentric: Floats) -> SurfacePoint:
    """Return the point of a face that has these barycentric coordinates, (3,)."""
    count, shares = len(mesh.faces), np.asarray(barycentric, np.float64)
    if not 0 <= face < count:
        raise HandlesError(
            f"there is no face {face}; the mesh has {group_digits(count)} triangles, numbered "
            "from 0 to "
            f"{count - 1}"
        )
    if shares.shape != (3,) or not np.isfinite(shares).all():
        raise HandlesError(
            f"barycentric is {np.asarray(barycentric).tolist()}, expected three finite numbers"
        )
    if abs(shares.sum() - 1) > BARYCENTRIC_TOL:
        raise HandlesError(f"barycentric has the sum {shares.sum():.10g}, expected 1")
    if shares.min() < -BARYCENTRIC_TOL:
        raise HandlesError(
            f"barycentric has {shares.min():g}, expected 0 or above: the point is outside the face"
        )
    return SurfacePoint(mesh.faces[face], shares / shares.sum())


@check_call
def closest_point(mesh: TriMesh, position: Floats) -> SurfacePoint:
    """Return the point of the surface closest to a position in space, (3,).

    Raises
    ------
    HandlesError
        Unless the position is three finite numbers of at most `MAX_COORDINATE`.

    Examples
    --------
    >>> from cageik_cli import closest_point, load_mesh
    >>> rest = load_mesh("data_fixtures/walker/frames/walker_1.obj")
    >>> point = closest_point(rest, rest.vertices[1040])
    >>> bool(abs(point.position(rest.vertices) - rest.vertices[1040]).max() < 1e-9)
    True
    """
    from scipy.optimize import nnls  # slow to import, and few handles files need it

    place = np.asarray(position, np.float64)
    if place.shape != (3,) or not (np.abs(place) <= MAX_COORDINATE).all():
        raise HandlesError(
            f"{place.tolist()} is no place; expected three finite numbers of at most "
            f"{MAX_COORDINATE:g}"
        )
    nearest = closest_points(mesh, place[None])
    corners = mesh.faces[nearest.face[0]]
    away = (mesh.vertices[corners] - nearest.position[0]) / (mesh.diagonal or 1.0)
    # On a face without area a point has many coordinates: any that are not negative will do.
    shares, _ = nnls(np.vstack([away.T, np.ones(3)]), np.array([0.0, 0, 0, 1]))
    return SurfacePoint(corners, shares / shares.sum())


@check_call
def pick(mesh: TriMesh, camera: Camera, pixel: Floats) -> SurfacePoint:
    """Return the front-most point of the surface that is visible in a pixel, (2,).

    Faces are hit from both sides, and no ray passes between two adjacent faces.

    Raises
    ------
    HandlesError
        When nothing is visible there between the near and the far plane.

    Examples
    --------
    >>> import numpy as np
    >>> from cageik_cli import Camera, load_mesh, pick
    >>> rest = load_mesh("data_fixtures/walker/frames/walker_1.obj")
    >>> eye, chest, up = np.array([[0.0, 1.2, 5], [0, 1.2, 0], [0, 1, 0]])
    >>> camera = Camera.from_look_at(eye, chest, up=up, fov_degrees=40, width=640, height=480)
    >>> point = pick(rest, camera, np.array([320, 240]))
    >>> bool(point.position(rest.vertices)[2] > 0)
    True

    References
    ----------
    Woop, Benthin and Wald 2013: edge functions that adjacent faces share bit for bit.
    """
    if np.shape(pixel) != (2,):
        raise HandlesError(f"a pixel has shape {np.shape(pixel)}, expected two numbers, x and y")
    origins, directions, lengths = camera.cast_rays(np.asarray(pixel, np.float64)[None])
    # Along the ray, and in two directions across it.
    across = np.cross(directions[0], np.eye(3)[np.abs(directions[0]).argmin()])
    across /= np.linalg.norm(across)
    axes = np.stack([across, np.cross(directions[0], across), directions[0]])
    seen = (mesh.vertices - origins[0]) @ axes.T
    x, y, depth = (np.ascontiguousarray(column)[mesh.faces].T for column in seen.T)
    edges = np.roll(x, -2, axis=0) * np.roll(y, -1, axis=0)
    edges = np.roll(x, -1, axis=0) * np.roll(y, -2, axis=0) - edges
    area = edges.sum(axis=0)
    is_hit = ((edges >= 0).all(axis=0) | (edges <= 0).all(axis=0)) & (area != 0)
    faces = np.flatnonzero(is_hit)
    shares = edges[:, faces] / area[faces]
    depths = (shares * depth[:, faces]).sum(axis=0)
    is_seen = (depths >= 0) & (depths <= lengths[0])
    if not is_seen.any():
        x_text, y_text = (f"{value:g}" for value in pixel)
        beyond = ", but only outside the near and far planes" if len(faces) else ""
        verb = "meets" if beyond else "misses"
        raise HandlesError(
            f"pixel ({x_text}, {y_text}) of {camera.width:g} x {camera.height:g} {verb} the mesh"
            f"{beyond}; {_suggest_visible_pixels(mesh, camera)}"
        )
    nearest = int(np.where(is_seen, depths, np.inf).argmin())
    return SurfacePoint(mesh.faces[faces[nearest]], shares[:, nearest])


def _suggest_visible_pixels(mesh: TriMesh, camera: Camera) -> str:
    """Return what to do about a pixel that does not show the mesh."""
    try:
        seen = camera.project(mesh.vertices)[:, :2]
    except InputError:
        return (
            "choose a pixel that shows it, or correct the camera: part of the mesh is behind it; "
            "its view must map the units and axes of the mesh to the eye"
        )
    (left, upper), (right, lower) = seen.min(axis=0), seen.max(axis=0)
    return (
        f"choose a pixel that shows it: x {left:.0f} to {right:.0f}, y {upper:.0f} to {lower:.0f}"
    )
