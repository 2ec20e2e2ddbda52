"""Meshes as they are read from files."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.formats.base.polygons import replace_folded_fans
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface_attributes import SurfaceAttributes
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError
from cageik_cli.util.text import format_count


@dataclass(frozen=True, slots=True, eq=False)
class FileMesh:
    """The content of a mesh file, not yet checked.

    Attributes
    ----------
    vertices : (n, 3) float64
        Each value is `float(text)` to the bit; may not be finite.
    faces : (f, 3) int64
        From 0; polygons are cut into fans at their first corner.
    corner_counts : (p,) int64
        How many corners each face of the file has.
    attributes : SurfaceAttributes, optional
        What else the file says of the surface; its polygons alone if absent.
    left_out : tuple of str
        What of that cannot be used, one sentence each.
    """

    vertices: Floats
    faces: Integers
    corner_counts: Integers
    attributes: SurfaceAttributes | None = None
    left_out: tuple[str, ...] = ()

    @property
    def polygon_count(self) -> int:
        """Number of faces with more than three corners."""
        return int(np.count_nonzero(self.corner_counts > 3))

    @property
    def corners(self) -> Integers:
        """The vertices of the faces of the file, one face after the other, (c,)."""
        first = np.cumsum(self.corner_counts - 2) - (self.corner_counts - 2)
        corners = np.empty(int(self.corner_counts.sum()), np.int64)
        starts = np.cumsum(self.corner_counts) - self.corner_counts
        corners[starts], corners[starts + 1] = self.faces[first, 0], self.faces[first, 1]
        is_later = np.ones(len(corners), bool)
        is_later[starts] = is_later[starts + 1] = False
        corners[is_later] = self.faces[:, 2]
        return corners

    def make_mesh(self) -> TriMesh:
        """Return the checked mesh, with polygons as fans, or as ears where a fan would fold over.

        Raises
        ------
        FormatError
        """
        mesh = TriMesh(self.vertices, self.faces)
        attributes = self.attributes
        if attributes is None and self.polygon_count:
            attributes = SurfaceAttributes(self.corner_counts, self.corners)
        if attributes is None or attributes.is_plain:
            return mesh
        return replace_folded_fans(TriMesh(mesh.vertices, mesh.faces, attributes))

    @property
    def notes(self) -> tuple[str, ...]:
        """What was changed, one sentence each."""
        if not self.polygon_count:
            return self.left_out
        cut = f"{format_count(self.polygon_count, 'polygon')} cut into triangles to compute with"
        return (cut, *self.left_out)


def check_not_points(vertex_count: int, face_count: int) -> None:
    """Refuse points without faces.

    Raises
    ------
    FormatError
    """
    if vertex_count and not face_count:
        raise FormatError(
            f"is a point cloud: {vertex_count} points and no faces, expected a mesh; reconstruct "
            "its surface, or export the mesh with its faces; deform --mesh and pose take points as "
            ".ply"
        )


@dataclass(frozen=True, slots=True, eq=False)
class LoadedMesh:
    """A mesh and where it came from.

    Attributes
    ----------
    source : dict
        `name` and `sha256` of the file; the name alone of a frame of the clip.
    notes : tuple of str
        What was changed, one sentence each.
    """

    mesh: TriMesh
    source: dict[str, str]
    notes: tuple[str, ...] = ()
