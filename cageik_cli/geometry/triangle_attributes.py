"""The attributes of a surface, cut into those of its triangles: what graphics hardware draws."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.normals import complete_fans
from cageik_cli.util.arrays import Floats, Integers


@dataclass(frozen=True, slots=True, eq=False)
class TriangleAttributes:
    """What a file says of the t triangles of a mesh, corner by corner.

    Attributes
    ----------
    uvs : (t, 3, 2) float64, optional
        With v upward; zero where a corner has none.
    normal_fans : (t, 3) int64, optional
        Which of the normals of the fans that `complete_fans` returns.
    materials : (t,) int64, optional
        Which of the names; `NONE` for a triangle without.
    material_colours : (k, 4) float64, optional
        Linear red, green, blue and opacity of each name.
    """

    uvs: Floats | None = None
    normal_fans: Integers | None = None
    materials: Integers | None = None
    material_names: tuple[str, ...] = ()
    material_colours: Floats | None = None


def cut_attributes(mesh: TriMesh) -> TriangleAttributes:
    """Return the attributes of the triangles of a mesh, in their order."""
    attributes = mesh.attributes
    if attributes is None:
        return TriangleAttributes()
    corners = find_triangle_corners(mesh)
    uvs, labels = attributes.uvs, attributes.materials
    fans = None if attributes.normal_fans is None else complete_fans(attributes).normal_fans
    table = None if uvs is None else np.concatenate([uvs.values, np.zeros((1, 2))])
    return TriangleAttributes(
        # `NONE` is the last of the table.
        uvs=None if uvs is None or table is None else table[uvs.indices[corners]],
        normal_fans=None if fans is None else fans[corners],
        materials=None if labels is None else labels.indices[attributes.triangle_polygons],
        material_names=() if labels is None else labels.names,
        material_colours=attributes.material_colours,
    )


def find_triangle_corners(mesh: TriMesh) -> Integers:
    """Find the corners of the polygons that the corners of the triangles are, (t, 3).

    The mesh has attributes. A polygon that has a vertex twice gives the first of its corners there.
    """
    attributes = mesh.attributes
    assert attributes is not None
    size = len(mesh.vertices)
    polygons = np.repeat(np.arange(len(attributes.corner_counts)), attributes.corner_counts)
    keys = polygons * size + attributes.corners
    order = np.argsort(keys, kind="stable")
    wanted = attributes.triangle_polygons[:, None] * size + mesh.faces
    return np.asarray(order[np.searchsorted(keys[order], wanted)])
