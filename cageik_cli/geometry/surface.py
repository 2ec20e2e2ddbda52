"""Points and a surface: closest points, barycentric weights, winding numbers."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util import compiled
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.threads import run_blocks

SURFACE_TOL = 1e-12
"""A point closer to a surface than this, in diagonals, is on it."""

ROUNDING_TOL = 8 * np.finfo(np.float64).eps
"""The same in the largest coordinate: more for a mesh far from the origin."""


MAX_COMPARED_PAIRS = 40_000_000
"""Pairs of points and faces that are all compared, where that is compiled, in 0.1 s. For more, the
trees of libigl are faster, and worth their import."""

PAIRS_PER_BLOCK = 500_000
"""Pairs of points and faces that one thread compares at once."""


@dataclass(frozen=True, slots=True, eq=False)
class ClosestPoints:
    """The surface point nearest to each of m points.

    Attributes
    ----------
    mesh : TriMesh
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
    def is_touching(self) -> NDArray[np.bool_]:
        """Which points are on the surface, up to rounding, (m,)."""
        largest = np.abs(self.mesh.vertices).max()
        return np.asarray(
            self.distance <= max(SURFACE_TOL * self.mesh.diagonal, ROUNDING_TOL * largest)
        )

    def barycentric_weights(self, chosen: NDArray[np.bool_]) -> Floats:
        """Return the barycentric weights of the `chosen` closest points, (count, n)."""
        corners = self.mesh.faces[self.face[chosen]]
        weights = np.zeros((len(corners), len(self.mesh.vertices)))
        np.put_along_axis(weights, corners, self.barycentric_coordinates(chosen), axis=1)
        return weights

    def barycentric_coordinates(self, chosen: NDArray[np.bool_]) -> Floats:
        """Return barycentric coordinates of the `chosen` closest points in their faces, (c, 3)."""
        a, b, c = self.mesh.vertices[self.mesh.faces[self.face[chosen]]].swapaxes(0, 1)
        along, beside, inside = b - a, c - a, self.position[chosen] - a
        aa, ab, bb = _dot(along, along), _dot(along, beside), _dot(beside, beside)
        pa, pb = _dot(inside, along), _dot(inside, beside)
        size = aa * bb - ab * ab
        size[size == 0] = 1  # a face without area: its first corner
        second, third = (bb * pa - ab * pb) / size, (aa * pb - ab * pa) / size
        return np.stack([1 - second - third, second, third], axis=1)


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("ix,ix->i", a, b))


def closest_points(mesh: TriMesh, points: Floats) -> ClosestPoints:
    """Find the point of `mesh` nearest to each of `points`, (m, 3)."""
    if not _can_compare(mesh, points):
        import igl

        squares, face, position = igl.point_mesh_squared_distance(points, mesh.vertices, mesh.faces)
        return ClosestPoints(mesh, np.sqrt(squares), face.astype(np.int64), position)
    squares, face = np.empty(len(points)), np.empty(len(points), np.int64)
    position = np.empty((len(points), 3))
    _compare_faces(compiled.kernel.closest_points, mesh, points, (squares, face, position))
    return ClosestPoints(mesh, np.sqrt(squares), face, position)


def _can_compare(mesh: TriMesh, points: Floats) -> bool:
    return compiled.kernel is not None and len(mesh.faces) * len(points) <= MAX_COMPARED_PAIRS


def _compare_faces(
    function: Callable[..., None], mesh: TriMesh, points: Floats, results: tuple[np.ndarray, ...]
) -> None:
    """Call a compiled function with all faces and blocks of points, for blocks of its results."""
    places, vertices = (np.ascontiguousarray(v, np.float64) for v in (points, mesh.vertices))
    faces = np.ascontiguousarray(mesh.faces)

    def fill(block: slice) -> None:
        function(places[block], vertices, faces, *(result[block] for result in results))

    run_blocks(fill, len(points), PAIRS_PER_BLOCK // max(1, len(faces)))


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
    if not _can_compare(mesh, points):
        import igl

        return np.asarray(igl.winding_number(mesh.vertices, mesh.faces, points), np.float64).ravel()
    winding = np.empty(len(points))
    _compare_faces(compiled.kernel.winding_numbers, mesh, points, (winding,))
    return winding
