"""Models that are their own mirror images, and the frame whose axis is across their plane."""

import numpy as np

from cageik_cli.cages.builder.frame import Frame
from cageik_cli.cages.surface_points import sample_surface, take_evenly
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.mirror import Mirror
from cageik_cli.geometry.surface import closest_points
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import NumericalError

MAX_MODEL_ASYMMETRY = 0.005
"""How far the mirror image of a model may be from it anywhere, in diagonals."""

MAX_ROUGH_ASYMMETRY = 0.02
"""The same on average, for a plane that is worth refining."""

ASYMMETRY_TIE = 1e-4
"""Asymmetries are rounded to it, in diagonals: simple shapes have several planes, and scans are not
exact."""

MAX_PLANE_STEPS = 12
"""Steps in which a plane is refined, at most."""

MIN_PLANE_DISTANCE = 1e-3
"""How near to the plane a vertex of a cage may be that is not on it, in units of the frame."""


def find_symmetry(model: TriMesh, wanted: str) -> Mirror | None:
    """Return the plane that a cage is to be symmetric about, if any.

    Parameters
    ----------
    wanted : str
        "off"; "x", "y" or "z" for a plane across that axis, whatever the model is; or "auto" for
        the plane across which the model is its own mirror image, if there is one.
    """
    if wanted == "off" or not model.diagonal > 0:
        return None
    search = _PlaneSearch(model)
    if wanted != "auto":
        return search.place_across("xyz".index(wanted))
    mirror, asymmetry = search.find_best()
    return mirror if asymmetry <= MAX_MODEL_ASYMMETRY else None


class _PlaneSearch:
    """The points of a surface, whose mirror images are to be on it."""

    def __init__(self, model: TriMesh) -> None:
        self._surface = model.drop_unused_vertices()
        self._points = sample_surface(self._surface)
        self._few = take_evenly(self._points, 300)
        self._centre, moments = measure_moments(self._surface)
        self._axes = np.linalg.eigh(moments)[1].T

    def place_across(self, axis: int) -> Mirror:
        """Return the plane across an axis: through the origin, unless another fits better."""
        normal = np.eye(3)[axis]
        origin = Mirror(normal, np.zeros(3))
        other = self._refine(Mirror(normal, self._centre), keeps_normal=True)
        enough = max(MAX_MODEL_ASYMMETRY / 2, 1.2 * self._measure(other))
        return origin if self._measure(origin) <= enough else other

    def find_best(self) -> tuple[Mirror, float]:
        """Return the plane of the least asymmetry, and that, in diagonals.

        Of those that are equally good, coordinate planes come first.
        """
        found: list[tuple[int, int, Mirror, float]] = []
        for place, mirror in enumerate(self._list_candidates()):
            asymmetry = self._measure(mirror)
            found.append((round(asymmetry / ASYMMETRY_TIE), place, mirror, asymmetry))
        best = min(found, key=lambda one: one[:2])
        return best[2], best[3]

    def _list_candidates(self) -> list[Mirror]:
        """Return planes across the axes, through the origin and moved, and refined ones."""
        axes, limit = np.eye(3), MAX_ROUGH_ASYMMETRY * self._surface.diagonal
        through = [Mirror(axis, self._centre) for axis in (*axes, *self._axes)]
        is_near = [self._find_images(mirror)[1].mean() < limit for mirror in through]
        near = [mirror for mirror, is_kept in zip(through, is_near, strict=True) if is_kept]
        across = [mirror for mirror in near if np.count_nonzero(mirror.normal) == 1]
        moved = [self._refine(mirror, keeps_normal=True) for mirror in across]
        refined = [self._refine(mirror, keeps_normal=False) for mirror in near]
        return [*(Mirror(axis, np.zeros(3)) for axis in axes), *moved, *refined]

    def _measure(self, mirror: Mirror) -> float:
        """Return the largest distance of the mirror image from the surface, in diagonals."""
        largest = self._find_images(mirror)[1].max()
        if largest < 2 * MAX_MODEL_ASYMMETRY * self._surface.diagonal:  # else it is not taken
            largest = closest_points(self._surface, mirror.reflect(self._points)).distance.max()
        return float(largest / self._surface.diagonal)

    def _find_images(self, mirror: Mirror) -> tuple[Floats, Floats]:
        """Return surface points closest to mirror images of a few, (s, 3), and how far they are."""
        closest = closest_points(self._surface, mirror.reflect(self._few))
        return closest.position, closest.distance

    def _refine(self, mirror: Mirror, *, keeps_normal: bool) -> Mirror:
        """Move the plane between points and the surface beside their mirror images.

        The best plane for pairs p, q is that across n, the eigenvector of Σ p qᵀ + q pᵀ, both
        centred, of the least eigenvalue, and through the middle of both centres.
        """
        for _ in range(MAX_PLANE_STEPS):
            images, _ = self._find_images(mirror)
            centre = (self._few.mean(axis=0) + images.mean(axis=0)) / 2
            normal = mirror.normal
            if not keeps_normal:
                p, q = self._few - self._few.mean(axis=0), images - images.mean(axis=0)
                normal = np.linalg.eigh(p.T @ q + q.T @ p)[1][:, 0]
            change = abs((centre - mirror.point) @ normal) / self._surface.diagonal
            change += np.linalg.norm(np.cross(normal, mirror.normal))
            mirror = Mirror(normal, centre)
            if change < 1e-9:
                break
        return mirror


def measure_moments(surface: TriMesh) -> tuple[Floats, Floats]:
    """Return the centre of a surface's area, (3,), and the second moments about it, (3, 3)."""
    corners, areas = surface.vertices[surface.faces], surface.face_areas
    areas = areas / areas.sum() if areas.sum() > 0 else np.full(len(areas), 1 / len(areas))
    centre = areas @ corners.mean(axis=1)
    corners = corners - centre
    total = corners.sum(axis=1)
    moments = np.einsum("f,fkx,fky->xy", areas, corners, corners) + (total.T * areas) @ total
    return np.asarray(centre), np.asarray(moments / 12)


class MirrorFrame:
    """The frame of a model together with its mirror image; one of its axes is across the plane.

    Coordinates of mirror images differ in the sign of that axis alone, to the last bit; in file
    units, too, where the plane is a coordinate plane through 0, and elsewhere up to rounding.

    Attributes
    ----------
    axis : int
        The one across the plane, which is at 0.
    """

    def __init__(self, model: TriMesh, mirror: Mirror) -> None:
        across = int(np.abs(mirror.normal).argmax())
        if np.count_nonzero(mirror.normal) == 1:
            self._turn = np.roll(np.eye(3), -across, axis=0)
        else:
            self._turn = np.linalg.qr(np.column_stack([mirror.normal, np.eye(3)]))[0].T
            self._turn[2] *= np.linalg.det(self._turn)  # right-handed: faces stay outward
        self._offset = np.array([float(self._turn[0] @ mirror.point), 0.0, 0.0])
        placed = TriMesh(self._to_plane(model.vertices), model.faces)
        # Boxes around a model that is turned, or has its image beside it, have other diagonals.
        self._frame = Frame(add_image(placed, 0), model.diagonal)
        ends = self._frame.to_units(np.array([[1.0, 0, 0], [-1, 0, 0]]))
        self.axis = int(np.abs(ends[0] - ends[1]).argmax())

    def to_units(self, points: Floats) -> Floats:
        """Return places in file units, (..., 3), in units of the frame."""
        return self._frame.to_units(self._to_plane(points))

    def to_file_units(self, points: Floats) -> Floats:
        """Undo it, for (k, 3) points."""
        return np.asarray((self._frame.to_file_units(points) + self._offset) @ self._turn)

    def _to_plane(self, points: Floats) -> Floats:
        return np.asarray(points @ self._turn.T - self._offset)


def reflect(points: Floats, axis: int) -> Floats:
    """Return the mirror images of points, (..., 3), across the plane where a coordinate is 0."""
    return np.asarray(points * np.where(np.arange(3) == axis, -1.0, 1.0))


def add_image(mesh: TriMesh, axis: int) -> TriMesh:
    """Return a mesh and its mirror image, joined where a vertex is on the plane."""
    on_plane = mesh.vertices[:, axis] == 0
    number = np.where(on_plane, np.arange(len(on_plane)), len(on_plane) + np.cumsum(~on_plane) - 1)
    vertices = np.concatenate([mesh.vertices, reflect(mesh.vertices[~on_plane], axis)])
    return TriMesh(vertices, np.concatenate([mesh.faces, number[mesh.faces][:, ::-1]]))


def mirror_points(points: Floats, axis: int) -> Floats:
    """Return the points on the side above 0, and their mirror images."""
    above = points[points[:, axis] >= 0]
    return np.concatenate([above, reflect(above[above[:, axis] > 0], axis)])


def find_partners(vertices: Floats, axis: int) -> Integers:
    """Return the partner of each vertex of a mesh that is its own mirror image to the last bit."""
    order, other = (np.lexsort((v + 0.0).T) for v in (vertices, reflect(vertices, axis)))
    partners = np.empty_like(order)
    partners[order] = other
    return partners


def pair_exactly(vertices: Floats, axis: int) -> Floats:
    """Return vertices that are mirror images up to rounding, as they are to the last bit.

    Raises
    ------
    NumericalError
        When they are not, as where they were rounded far from the origin.
    """
    partners = Mirror(np.eye(3)[axis], np.zeros(3)).find_pairs(vertices)
    if partners is None:
        raise NumericalError("the cage is not its own mirror image (rounded too far away)")
    return np.asarray((vertices + reflect(vertices[partners], axis)) / 2)


def average_sides(mesh: TriMesh, before: TriMesh, axis: int) -> TriMesh:
    """Return a mesh whose two sides are the mean of both, and keep apart.

    Parameters
    ----------
    before : TriMesh
        The mesh before its vertices were moved, its own mirror image.
    """
    partners = find_partners(before.vertices, axis)
    vertices = (mesh.vertices + reflect(mesh.vertices[partners], axis)) / 2
    side = np.sign(before.vertices[:, axis])
    vertices[:, axis] = side * np.maximum(side * vertices[:, axis], MIN_PLANE_DISTANCE)
    return TriMesh(vertices, mesh.faces)


def take_half(mesh: TriMesh, axis: int) -> TriMesh:
    """Return the part above the plane of a mesh no edge of which crosses it."""
    is_above = (mesh.vertices[:, axis] >= 0)[mesh.faces].all(axis=1)
    return TriMesh(mesh.vertices, mesh.faces[is_above]).drop_unused_vertices()


def cut_half(mesh: TriMesh, axis: int) -> TriMesh:
    """Return the part of a closed mesh above the plane; its border is on the plane.

    Vertices that are too near to the plane are moved off it.
    """
    heights = mesh.vertices[:, axis]
    moved = mesh.vertices.copy()
    moved[:, axis] = np.where(np.abs(heights) < MIN_PLANE_DISTANCE, MIN_PLANE_DISTANCE, heights)
    is_above = moved[:, axis] > 0
    kept = list(map(tuple, mesh.faces[is_above[mesh.faces].all(axis=1)].tolist()))
    ends = mesh.edges.ends[is_above[mesh.edges.ends].sum(axis=1) == 1]
    height = moved[ends, axis]
    share = height[:, 0] / (height[:, 0] - height[:, 1])
    crossings = moved[ends[:, 0]] + share[:, None] * (moved[ends[:, 1]] - moved[ends[:, 0]])
    crossings[:, axis] = 0
    at = {(a, b): len(moved) + k for k, (a, b) in enumerate(ends.tolist())}
    for face in mesh.faces[is_above[mesh.faces].any(axis=1) & ~is_above[mesh.faces].all(axis=1)]:
        # The corner that is alone on its side comes first.
        alone = is_above[face] == (is_above[face].sum() == 1)
        a, b, c = np.roll(face, -int(alone.argmax())).tolist()
        ab, ca = at[min(a, b), max(a, b)], at[min(a, c), max(a, c)]
        kept += [(a, ab, ca)] if is_above[a] else [(ab, b, c), (ab, c, ca)]
    return TriMesh(np.concatenate([moved, crossings]), np.array(kept)).drop_unused_vertices()
