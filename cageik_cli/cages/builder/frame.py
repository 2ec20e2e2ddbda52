"""The frame in which a cage is built, and the plane of models that are their own mirror images.

The frame is the same one however a file states the surface. An axis of it is across the plane.
"""

from itertools import permutations, product

import numpy as np

from cageik_cli.cages.surface_points import sample_surface, take_evenly
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.mirror import Mirror
from cageik_cli.geometry.shape import lumped_areas
from cageik_cli.geometry.surface import closest_points
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import NumericalError

MOMENT_TIE_TOL = 1e-5
"""Moments of the surface that differ by less are a tie, in units of the frame."""

MOMENT_POWERS = tuple(
    powers
    for degree in (2, 3, 4)
    for powers in product((4, 3, 2, 1, 0), repeat=3)
    if sum(powers) == degree
)
"""Of the coordinates in the moments that tell the axes: a model whose moments are all the same when
it is turned is taken to be symmetric."""

AXIS_TURNS = tuple(
    (order, signs)
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
    if np.linalg.det(np.eye(3)[list(order)] * np.array(signs)[:, None]) > 0
)
"""The 24 ways to permute axes and turn them over that are turns, as orders and signs; the first
leaves them as they are."""

PLACE_STEP = 2.0**-30
"""Places are rounded to multiples of it, in units of the frame. It is far more than the rounding of
double precision, and far less than a clearance; round numbers are no odd multiples of its half."""

PLACE_DECIMALS = 6
"""Digits of a position that decide which vertex comes first: single precision has seven."""

MAX_UNEVENNESS = 1e-4
"""How far points are moved so that no two edges of a symmetric shape are equally long, and no plane
is flat, in units of the frame: otherwise, the last digits of a file would decide."""

WAVES = np.array([[68.5, 86.5, 45.5], [44.5, 74.5, 98.5], [80.5, 36.5, 63.5]])
"""Wave vectors of these moves, per unit of the frame: no two are alike along any axis. Waves are as
long as ten cells of a shell's grid, and bend a plane over one by more than single precision."""

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


class Frame:
    """A model's own frame: its box at the origin, of a diagonal of one, its longest axis first.

    Axes are permuted and turned over, as the surface is spread along them and leans to one side,
    and stay right-handed. A model that is moved, scaled or turned by 90 degrees has the same
    coordinates in it, unless it is symmetric.

    Parameters
    ----------
    unit : float, optional
        In place of the diagonal, file units.
    """

    def __init__(self, model: TriMesh, unit: float | None = None) -> None:
        low, high = model.vertices.min(axis=0), model.vertices.max(axis=0)
        self._centre, self._scale = low + (high - low) / 2, unit or model.diagonal
        self._order, self._signs = np.arange(3), np.ones(3)
        # By area: the same for vertices that are split where normals or UVs differ.
        order, signs = _choose_turn(self.to_units(model.vertices), lumped_areas(model))
        self._order, self._signs = np.array(order), np.array(signs)

    def to_units(self, points: Floats) -> Floats:
        """Return places in file units, (..., 3), in units of the frame."""
        units = (points - self._centre) / self._scale
        return np.asarray(units[..., self._order] * self._signs)

    def to_file_units(self, points: Floats) -> Floats:
        """Undo the turn, the move and the scale of (k, 3) points."""
        turned = np.empty_like(points)
        turned[:, self._order] = points * self._signs
        return np.asarray(turned * self._scale + self._centre)


def _choose_turn(points: Floats, areas: Floats) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Return the turn that makes moments largest, each where those before it leave a choice.

    The first is the spread along x, then come that along y, how far all axes lean, and the others.
    """
    shares = areas / areas.sum() if areas.sum() > 0 else np.full(len(areas), 1 / len(areas))
    moments = {powers: float(shares @ (points**powers).prod(axis=1)) for powers in MOMENT_POWERS}
    deciding = []
    for order, signs in AXIS_TURNS:
        turned = {}
        for powers in moments:
            before = tuple(powers[order.index(axis)] for axis in range(3))
            turned[powers] = float(np.prod(np.power(signs, powers))) * moments[before]
        lean = turned[3, 0, 0] + turned[0, 3, 0] + turned[0, 0, 3]
        deciding.append([turned[2, 0, 0], turned[0, 2, 0], lean, *turned.values()])
    left = np.arange(len(AXIS_TURNS))
    for values in np.array(deciding).T:
        left = left[values[left] > values[left].max() - MOMENT_TIE_TOL]
    return AXIS_TURNS[left[0]]


def round_places(points: Floats) -> Floats:
    """Return places in the frame, (k, 3), without the rounding of the file's coordinates.

    All choices of the builder are then the same, however the model was moved, turned or scaled.
    """
    return np.asarray(np.round(points / PLACE_STEP) * PLACE_STEP)


def sort_mesh(mesh: TriMesh) -> TriMesh:
    """Return a mesh with its vertices ordered by their places, and its faces by their vertices."""
    order = np.lexsort(mesh.vertices.round(PLACE_DECIMALS).T[::-1])
    number = np.empty_like(order)
    number[order] = np.arange(len(order))
    faces = number[mesh.faces]
    first = (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3
    faces = np.take_along_axis(faces, first, axis=1)
    return TriMesh(mesh.vertices[order], faces[np.lexsort(faces.T[::-1])])


def break_ties(points: Floats) -> Floats:
    """Move points, (k, 3), by smooth waves that have no symmetry, `MAX_UNEVENNESS` at most."""
    return np.asarray(points + MAX_UNEVENNESS * np.sin(points @ WAVES.T + [0.3, 1.1, 2.3]))


def find_symmetry(model: TriMesh, wanted: str) -> tuple[Mirror | None, str | None]:
    """Return the plane that a cage is to be symmetric about, if any, and a note if none was found.

    Parameters
    ----------
    wanted : str
        "off"; "x", "y" or "z" for a plane across that axis, whatever the model is; or "auto" for
        the plane across which the model is its own mirror image, if there is one.
    """
    if wanted == "off" or not model.diagonal > 0:
        return None, None
    search = _PlaneSearch(model)
    if wanted != "auto":
        return search.place_across("xyz".index(wanted)), None
    mirror, asymmetry = search.find_best()
    if asymmetry <= MAX_MODEL_ASYMMETRY:
        return mirror, None
    return None, (
        f"the cage is not symmetric, as the model is not: mirrored about {mirror}, it is up to "
        f"{100 * asymmetry:.2g} % of the diagonal from itself (expected at most "
        f"{100 * MAX_MODEL_ASYMMETRY:g} %); name an axis (x, y or z) to build a symmetric cage "
        "all the same"
    )


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

        Tried are planes across the axes, through the origin and moved, and refined ones. Of those
        that are equally good, the first counts.
        """
        axes, limit = np.eye(3), MAX_ROUGH_ASYMMETRY * self._surface.diagonal
        through = [Mirror(axis, self._centre) for axis in (*axes, *self._axes)]
        near = [mirror for mirror in through if self._find_images(mirror)[1].mean() < limit]
        across = [mirror for mirror in near if np.count_nonzero(mirror.normal) == 1]
        tried = [
            *(Mirror(axis, np.zeros(3)) for axis in axes),
            *(self._refine(mirror, keeps_normal=True) for mirror in across),
            *(self._refine(mirror, keeps_normal=False) for mirror in near),
        ]
        found = [(mirror, self._measure(mirror)) for mirror in tried]
        return min(found, key=lambda one: round(one[1] / ASYMMETRY_TIE))

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
