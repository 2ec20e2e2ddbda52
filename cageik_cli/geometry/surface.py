"""Points and a surface: closest points, barycentric weights, winding numbers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers

SURFACE_TOL = 1e-12
"""A point closer to a surface than this, in diagonals, is on it."""

ROUNDING_TOL = 8 * np.finfo(np.float64).eps
"""The same in the largest coordinate: more for a mesh far from the origin."""


MAX_COMPARED_PAIRS = 100_000
"""Pairs of points that are all compared: a tree takes longer to import."""


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
        if len(corners):
            a, b, c = (self.mesh.vertices[corners[:, k]] for k in range(3))
            import igl

            barycentric = igl.barycentric_coordinates(self.position[chosen], a, b, c)
            np.put_along_axis(weights, corners, barycentric, axis=1)
        return weights


def closest_points(mesh: TriMesh, points: Floats) -> ClosestPoints:
    """Find the point of `mesh` nearest to each of `points`, (m, 3)."""
    import igl

    squares, face, position = igl.point_mesh_squared_distance(points, mesh.vertices, mesh.faces)
    return ClosestPoints(mesh, np.sqrt(squares), face.astype(np.int64), position)


def measure_distances(places: Floats, points: Floats) -> Floats:
    """Return the distance of each of `points`, (m, 3), from the nearest of `places`, (n, 3)."""
    if len(points) * len(places) <= MAX_COMPARED_PAIRS:
        offsets = points[:, None] - places
        return np.asarray(np.linalg.norm(offsets, axis=2).min(axis=1))
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(places).query(points)[0])


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
    import igl

    return np.asarray(igl.winding_number(mesh.vertices, mesh.faces, points), np.float64).ravel()
