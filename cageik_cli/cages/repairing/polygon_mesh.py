"""A cage whose faces may be quads: the rings of its polygons, and the triangles to compute with."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.normals import find_next_corners
from cageik_cli.geometry.surface_attributes import fan_triangulate, find_folded_triangles
from cageik_cli.util.arrays import Floats, Integers, Mask


@dataclass(frozen=True, eq=False)
class PolygonMesh:
    """Polygons whose corners follow one another, and their fans.

    Attributes
    ----------
    vertices : (n, 3) float64
        File units.
    corners : (c,) int64
        The rings of all polygons, one after the other.
    corner_counts : (p,) int64
        How many corners each polygon has, 3 or more.
    """

    vertices: Floats
    corners: Integers
    corner_counts: Integers

    @staticmethod
    def from_fans(mesh: TriMesh, corner_counts: Integers | None = None) -> "PolygonMesh":
        """Find the rings of polygons that were cut into fans at their first corners.

        Parameters
        ----------
        mesh : TriMesh
            The fans follow one another, as `formats` gives them before it mends folded ones.
        corner_counts : (p,) int64, optional
            Of the polygons; all are triangles by default.

        Raises
        ------
        ValueError
            When the triangles are not such fans.
        """
        if corner_counts is None:
            return PolygonMesh(mesh.vertices, mesh.faces.ravel(), np.full(len(mesh.faces), 3))
        if corner_counts.min() < 3 or (corner_counts - 2).sum() != len(mesh.faces):
            raise ValueError("the numbers of corners are not those of the mesh")
        parts = np.split(mesh.faces, np.cumsum(corner_counts - 2)[:-1])
        rings = [np.concatenate([fan[0, :2], fan[:, 2]]) for fan in parts]
        found = PolygonMesh.from_rings(mesh.vertices, rings)
        if not np.array_equal(found.triangles.faces, mesh.faces):
            raise ValueError("the triangles are not fans of polygons")
        return found

    @staticmethod
    def from_rings(vertices: Floats, rings: list[Integers]) -> "PolygonMesh":
        """Put the rings of polygons one after the other."""
        counts = np.array([len(ring) for ring in rings], np.int64)
        corners = np.concatenate([np.empty(0, np.int64), *rings]).astype(np.int64)
        return PolygonMesh(vertices, corners, counts)

    @cached_property
    def rings(self) -> list[Integers]:
        """Return the corners of each polygon."""
        return np.split(self.corners, np.cumsum(self.corner_counts)[:-1])

    @cached_property
    def polygon_numbers(self) -> Integers:
        """Return the polygon of each corner, (c,)."""
        return np.repeat(np.arange(len(self.corner_counts)), self.corner_counts)

    @cached_property
    def triangle_polygons(self) -> Integers:
        """Return the polygon of each triangle, (f,)."""
        return np.repeat(np.arange(len(self.corner_counts)), self.corner_counts - 2)

    @cached_property
    def next_places(self) -> Integers:
        """Return where the corner that follows each in its ring stands, (c,)."""
        return find_next_corners(self.corner_counts)

    @property
    def next_corners(self) -> Integers:
        """Return the corner that follows each in its ring, (c,)."""
        return self.corners[self.next_places]

    @cached_property
    def triangles(self) -> TriMesh:
        """Return the fans of the polygons at their first corners."""
        return TriMesh(self.vertices, fan_triangulate(self.corners, self.corner_counts))

    @cached_property
    def is_folded(self) -> Mask:
        """Return which polygons have a fan that folds over, (p,)."""
        counts = self.corner_counts - 2
        folded, _ = find_folded_triangles(self.vertices, self.triangles.faces, counts)
        return np.asarray(np.logical_or.reduceat(folded, np.cumsum(counts) - counts))

    def move(self, vertices: Floats) -> "PolygonMesh":
        """Return the same polygons with their vertices elsewhere."""
        return PolygonMesh(vertices, self.corners, self.corner_counts)

    def keep(self, chosen: Mask) -> "PolygonMesh":
        """Return only the chosen polygons, all vertices."""
        corners = self.corners[chosen[self.polygon_numbers]]
        return PolygonMesh(self.vertices, corners, self.corner_counts[chosen])

    def turn(self, chosen: Mask) -> "PolygonMesh":
        """Turn the chosen polygons over; first corners and diagonals stay."""
        rings = [
            np.concatenate([ring[:1], ring[:0:-1]]) if turned else ring
            for ring, turned in zip(self.rings, chosen, strict=True)
        ]
        return PolygonMesh.from_rings(self.vertices, rings)

    def unfold(self) -> "PolygonMesh":
        """Start folded fans at another corner; cut those that fold from every corner.

        A reader of the file then cuts the polygons into the very triangles that were tested.
        """
        if not self.is_folded.any():
            return self
        rings: list[Integers] = []
        for ring, folded in zip(self.rings, self.is_folded, strict=True):
            rings += _unfold_ring(self.vertices, ring) if folded else [ring]
        return PolygonMesh.from_rings(self.vertices, rings)


def _unfold_ring(vertices: Floats, ring: Integers) -> list[Integers]:
    for start in range(1, len(ring)):
        turned = np.roll(ring, -start)
        if not PolygonMesh.from_rings(vertices, [turned]).is_folded.any():
            return [turned]
    return list(PolygonMesh.from_rings(vertices, [ring]).triangles.faces)
