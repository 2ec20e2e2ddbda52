"""Points and a surface: closest points, barycentric weights, winding numbers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.points import order_by_place
from cageik_cli.util import compiled
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.threads import run_blocks

SURFACE_TOL = 1e-12
"""A point closer to a surface than this, in diagonals, is on it."""

SURFACE_ROUNDING_TOL = 8 * np.finfo(np.float64).eps
"""The same in the largest coordinate: more for a mesh far from the origin."""

CORNER_TOL = 1e-9
"""A closest point with no more of a corner than this is on the side across, or at the others."""

MAX_WINDING_PAIRS = 40_000_000
"""Pairs of points and faces whose angles are all summed, where that is compiled, in 0.1 s. For
more, the trees of libigl are faster, and worth their import."""

MAX_BOXED_PAIRS = 500_000_000
"""The same for closest points, which compare few faces: those in near boxes."""

MAX_UNSORTED_PAIRS = 20_000
"""Pairs up to which all are compared as they come: to sort points and faces would take longer."""

MAX_UNSORTED_FACES = 24
"""Faces up to which the same holds: they are in too few boxes for any to be passed over."""

FACES_PER_BOX = 8
"""Faces that share a box, as in the compiled core."""

MAX_THREAD_PAIRS = 500_000
"""Pairs of points and faces that one thread compares at once."""

MAX_THREAD_POINTS = 1024
"""Points whose closest points one thread finds at once."""


@dataclass(frozen=True, slots=True, eq=False)
class ClosestPoints:
    """The surface point nearest to each of m points.

    Attributes
    ----------
    distance : (m,) float64
        File units, never negative.
    face : (m,) int64
    position : (m, 3) float64
    """

    mesh: TriMesh
    distance: Floats
    face: Integers
    position: Floats

    @property
    def tolerance(self) -> float:
        """The distance up to which a point is on the surface."""
        largest = np.abs(self.mesh.vertices).max()
        return float(max(SURFACE_TOL * self.mesh.diagonal, SURFACE_ROUNDING_TOL * largest))

    @property
    def is_touching(self) -> NDArray[np.bool_]:
        """Which points are on the surface, up to rounding, (m,)."""
        return np.asarray(self.distance <= self.tolerance)

    def barycentric_weights(self, chosen: NDArray[np.bool_]) -> Floats:
        """Return the barycentric weights of the `chosen` closest points, (count, n)."""
        corners = self.mesh.faces[self.face[chosen]]
        weights = np.zeros((len(corners), len(self.mesh.vertices)))
        np.put_along_axis(weights, corners, self.barycentric_coordinates(chosen), axis=1)
        return weights

    def barycentric_coordinates(self, chosen: NDArray[np.bool_]) -> Floats:
        """Return barycentric coordinates of the `chosen` closest points in their faces, (c, 3)."""
        corners, positions = (
            self.mesh.vertices[self.mesh.faces[self.face[chosen]]],
            self.position[chosen],
        )
        a, b, c = corners.swapaxes(0, 1)
        along, beside, inside = b - a, c - a, positions - a
        aa, ab, bb = _dot(along, along), _dot(along, beside), _dot(beside, beside)
        pa, pb = _dot(inside, along), _dot(inside, beside)
        size, is_thin = _measure_faces(aa, ab, bb)
        second, third = (bb * pa - ab * pb) / size, (aa * pb - ab * pa) / size
        found = np.stack([1 - second - third, second, third], axis=1)
        found[is_thin] = _place_in_thin_faces(corners[is_thin], positions[is_thin])
        return found

    def differentiate_coordinates(self, coordinates: Floats) -> Floats:
        """Return how the barycentric coordinates of the closest points change with the points.

        A closest point in a face moves along the face, one on a side along the side, and one at a
        corner not at all. The closest point of a point on the surface counts as in its face; one in
        a face that is too thin to have gradients, as on its longest side.

        Parameters
        ----------
        coordinates : (m, 3)
            Of all closest points.

        Returns
        -------
        (m, 3, 3) float64
            The gradient of the coordinate of each corner, per file unit.
        """
        corners = self.mesh.vertices[self.mesh.faces[self.face]]
        first, along, beside = corners[:, 0], corners[:, 1], corners[:, 2]
        along, beside = along - first, beside - first
        aa, ab, bb = _dot(along, along), _dot(along, beside), _dot(beside, beside)
        size, is_thin = _measure_faces(aa, ab, bb)
        found = np.zeros((len(corners), 3, 3))
        found[:, 1] = (bb[:, None] * along - ab[:, None] * beside) / size[:, None]
        found[:, 2] = (aa[:, None] * beside - ab[:, None] * along) / size[:, None]
        found[:, 0] = -found[:, 1] - found[:, 2]
        is_off = (coordinates <= CORNER_TOL) & ~self.is_touching[:, None]
        thin = corners[is_thin]
        squares = np.square(thin[:, [2, 0, 1]] - thin[:, [1, 2, 0]]).sum(axis=2)
        is_off[is_thin] = np.arange(3) == squares.argmax(axis=1)[:, None]  # across the longest side
        on_side = np.flatnonzero(is_off.any(axis=1))
        found[on_side] = _differentiate_on_sides(corners[on_side], ~is_off[on_side])
        return found


def _measure_faces(aa: Floats, ab: Floats, bb: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return four times the squared areas of faces, (k,), and which are too thin to divide by them.

    `aa`, `ab` and `bb` are products of the sides at the first corners. Squares of thin ones are 1.
    """
    size = aa * bb - ab * ab
    longest = np.maximum(aa, bb)
    # The area of a face is too little to divide by up to this squared sine of its first corner,
    # and up to this squared width over length. Others are right to rounding over these.
    is_thin = ~(size > np.maximum(1e-3 * (aa * bb), 1e-6 * longest * longest))
    size[is_thin] = 1
    return size, is_thin


def _differentiate_on_sides(corners: Floats, is_on: NDArray[np.bool_]) -> Floats:
    """Return the gradients of coordinates, (k, 3, 3), on sides between corners, or at one corner.

    `is_on`, (k, 3), marks at most two corners; of a point at one corner, nothing changes.
    """
    rows, ends = np.arange(len(corners)), np.argsort(~is_on, axis=1, kind="stable")
    side = corners[rows, ends[:, 1]] - corners[rows, ends[:, 0]]
    side[is_on.sum(axis=1) < 2] = 0
    squares = _dot(side, side)
    slope = np.divide(side, squares[:, None], out=np.zeros_like(side), where=squares[:, None] > 0)
    found = np.zeros((len(corners), 3, 3))
    found[rows, ends[:, 0]], found[rows, ends[:, 1]] = -slope, slope
    return found


def _place_in_thin_faces(corners: Floats, positions: Floats) -> Floats:
    """Return the coordinates of positions in thin faces, (k, 3, 3), from their longest sides.

    The share of the corner across a longest side is that of the height, which is noise in a face
    without area. It is kept to what leaves the others at 0 or more: the position stays right.
    """
    squares = np.square(corners[:, [1, 2, 0]] - corners).sum(axis=2)
    order = (np.argmax(squares, axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(corners, order[:, :, None], axis=1).swapaxes(0, 1)
    side, across, inside = b - a, c - a, positions - a
    foot = _divide(_dot(across, side), _dot(side, side)).clip(0, 1)
    share = _divide(_dot(inside, side), _dot(side, side)).clip(0, 1)
    height = across - foot[:, None] * side
    third = _divide(_dot(inside - share[:, None] * side, height), _dot(height, height))
    most = np.minimum(_divide(share, foot, 1), _divide(1 - share, 1 - foot, 1))
    third = np.clip(third, 0, np.minimum(most, 1))
    second = np.clip(share - third * foot, 0, 1 - third)
    found = np.empty((len(order), 3))
    np.put_along_axis(found, order, np.stack([1 - second - third, second, third], axis=1), axis=1)
    return found


def _divide(values: Floats, by: Floats, otherwise: float = 0) -> Floats:
    """Return the quotients, and `otherwise` where there is none."""
    quotients = np.full(len(by), float(otherwise))
    np.divide(values, by, out=quotients, where=by > 0)
    return quotients


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("ix,ix->i", a, b))


def closest_points(mesh: TriMesh, points: Floats) -> ClosestPoints:
    """Find the point of `mesh` nearest to each of `points`, (m, 3), which are valid positions."""
    return ClosestPoints(mesh, *measure_closest(mesh.vertices, mesh.faces, points))


def measure_closest(
    vertices: Floats, faces: Integers, points: Floats
) -> tuple[Floats, Integers, Floats]:
    """Find closest points as `closest_points` does, in faces of arrays that are known to be valid.

    Builders of cages do so thousands of times for a few faces, which a mesh would check each time.

    Returns
    -------
    (m,), (m,), (m, 3)
        Distances, faces and positions.
    """
    if not _can_compare(faces, points, MAX_BOXED_PAIRS):
        import igl

        squares, face, position = igl.point_mesh_squared_distance(points, vertices, faces)
        return np.sqrt(squares), face.astype(np.int64), position
    is_sorted = len(faces) > MAX_UNSORTED_FACES and len(faces) * len(points) > MAX_UNSORTED_PAIRS
    order = order_by_place(points) if is_sorted else np.arange(len(points))
    places, vertices = (points[order] if is_sorted else _as_rows(points)), _as_rows(vertices)
    faces, boxes = _box_faces(vertices, faces, is_sorted)
    squares, face = np.empty(len(points)), np.empty(len(points), np.int64)
    position = np.empty((len(points), 3))

    def fill(block: slice) -> None:
        results = squares[block], face[block], position[block]
        compiled.kernel.closest_points(places[block], vertices, faces, boxes, *results)

    run_blocks(fill, len(points), max(MAX_THREAD_POINTS, MAX_THREAD_PAIRS // max(1, len(faces))))
    if not is_sorted:
        return np.sqrt(squares), face, position
    back = np.argsort(order)
    return np.sqrt(squares[back]), face[back], position[back]


def _can_compare(faces: Integers, points: Floats, most: int) -> bool:
    return compiled.kernel is not None and len(faces) * len(points) <= most


def _as_rows(values: Floats) -> Floats:
    return np.ascontiguousarray(values, np.float64)


def _box_faces(
    vertices: Floats, faces: Integers, is_sorted: bool
) -> tuple[Integers, tuple[Integers, Floats]]:
    """Return the faces, (f, 3), neighbours together if sorted; their numbers; boxes (b, 2, 3)."""
    a, b, c = (np.take(vertices, faces[:, k], axis=0) for k in range(3))
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    order = order_by_place(low + high) if is_sorted else np.arange(len(low))
    starts = np.arange(0, len(order), FACES_PER_BOX)
    low = np.minimum.reduceat(np.take(low, order, axis=0), starts)
    high = np.maximum.reduceat(np.take(high, order, axis=0), starts)
    return faces[order], (order, np.stack([low, high], axis=1))


def weights_on_surface(mesh: TriMesh, points: Floats) -> tuple[Floats, Integers]:
    """Return the barycentric weights of points on the surface, and which points are not on it.

    Returns
    -------
    (m, n) float64
        The rows of points off the surface are not set.
    (k,) int64
        Numbers of the points that are off the surface by more than rounding.
    """
    nearest = closest_points(mesh, points)
    weights = np.empty((len(points), len(mesh.vertices)))
    weights[nearest.is_touching] = nearest.barycentric_weights(nearest.is_touching)
    return weights, np.flatnonzero(~nearest.is_touching)


def winding_numbers(mesh: TriMesh, points: Floats) -> Floats:
    """Compute how often the surface winds around each point, (m,): 1 inside, 0 outside."""
    return measure_winding(mesh.vertices, mesh.faces, points)


def measure_winding(vertices: Floats, faces: Integers, points: Floats) -> Floats:
    """Compute winding numbers of arrays that are known to be valid, as `measure_closest` does."""
    if not _can_compare(faces, points, MAX_WINDING_PAIRS):
        import igl

        return np.asarray(igl.winding_number(vertices, faces, points), np.float64).ravel()
    winding, places, vertices = np.empty(len(points)), _as_rows(points), _as_rows(vertices)
    faces = np.ascontiguousarray(faces)

    def fill(block: slice) -> None:
        compiled.kernel.winding_numbers(places[block], vertices, faces, winding[block])

    run_blocks(fill, len(points), MAX_THREAD_PAIRS // max(1, len(faces)))
    return winding
