"""What a shader has to draw, computed from the frames by the polygons of the mesh."""

import numpy as np

from cageik_cli.formats.settings import Scene
from cageik_cli.geometry.parts import split_parts

Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Rows with z up times it have y up: (x, y, z) becomes (x, z, -y)."""

SCENES = {
    "metres, y up": (Scene(), np.eye(3)),
    "centimetres, z up": (Scene(up_axis="Z", metres_per_unit=0.01), 0.01 * Z_UP),
}
"""Scenes, and what brings rows of theirs into metres with y up."""


def list_triangles(mesh):
    """The triangles in the order of primitives: by part, then by material."""
    attributes = mesh.polygons
    material = np.zeros(len(mesh.faces), int)
    if attributes.materials is not None:
        material = attributes.materials.indices[attributes.triangle_polygons]
    part = np.zeros(len(mesh.faces), int)
    if attributes.parts is not None:
        ends = np.cumsum([len(each.mesh.faces) for each in split_parts(mesh)])
        part = np.searchsorted(ends, np.arange(len(mesh.faces)), side="right")
    return np.lexsort([material, part])


def shade(mesh, positions):
    """The normal of each corner of each triangle, from the areas of polygons.

    It is (t, 3, 3) for positions (m, 3), and (F, t, 3, 3) for those of frames, (F, m, 3).
    """
    attributes = mesh.polygons
    fans, sums, numbers = attributes.normal_fans, {}, {}
    for k, (start, count) in enumerate(
        zip(attributes.starts, attributes.corner_counts, strict=True)
    ):
        vertices = attributes.corners[start : start + count].tolist()
        points = positions[..., vertices, :]
        sides = points[..., 1:, :] - points[..., :1, :]
        area = np.cross(sides[..., :-1, :], sides[..., 1:, :]).sum(axis=-2)
        own = vertices if fans is None else fans[start : start + count].tolist()
        for vertex, fan in zip(vertices, own, strict=True):
            numbers[k, vertex] = fan
            sums[fan] = sums.get(fan, 0) + area
    found = [
        sums[numbers[k, vertex]]
        for k, face in zip(attributes.triangle_polygons.tolist(), mesh.faces.tolist(), strict=True)
        for vertex in face
    ]
    normals = np.stack(found, axis=-2).reshape(*positions.shape[:-2], -1, 3, 3)
    return normals / np.linalg.norm(normals, axis=-1)[..., None]


def angle_between(found, expected):
    """Degrees, the largest."""
    across = np.linalg.norm(np.cross(found, expected), axis=-1)
    return np.degrees(np.arctan2(across, (found * expected).sum(axis=-1))).max()
