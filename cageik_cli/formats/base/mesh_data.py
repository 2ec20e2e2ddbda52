"""Meshes as they are read from files."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError


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
    """

    vertices: Floats
    faces: Integers
    corner_counts: Integers

    @property
    def polygon_count(self) -> int:
        """Number of faces with more than three corners."""
        return int(np.count_nonzero(self.corner_counts > 3))

    @property
    def fan_triangulated(self) -> TriMesh:
        """The checked mesh with every polygon as a fan: connectivity is compared by it."""
        return TriMesh(self.vertices, self.faces)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was changed, one sentence each."""
        if not self.polygon_count:
            return ()
        plural = "s" * (self.polygon_count > 1)
        return (f"{self.polygon_count} polygon{plural} cut into triangles to compute with",)


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
    mesh : TriMesh
    fan_triangulated : TriMesh
        The same with every polygon as a fan: connectivity is compared by it.
    source : dict
        `name` and `sha256` of the file; the name alone of a frame of the clip.
    notes : tuple of str
        What was changed, one sentence each.
    obj_text : bytes
        The OBJ file, unpacked; empty for other formats.
    corner_counts : (p,) int64, optional
        Corners of each polygon, in the order of the fans; absent when a frame of a clip.
    """

    mesh: TriMesh
    fan_triangulated: TriMesh
    source: dict[str, str]
    notes: tuple[str, ...] = ()
    obj_text: bytes = b""
    corner_counts: Integers | None = None
