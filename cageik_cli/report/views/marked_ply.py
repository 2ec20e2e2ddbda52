"""A cage and its model in one PLY file, with colours of vertices that show the faults."""

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.report.plots.cage_marks import FaultMark, colour_vertices

_HEADER = """ply
format binary_little_endian 1.0
comment cage: the first {cage} vertices and {cage_faces} faces; then the rest pose
element vertex {vertices}
property double x
property double y
property double z
property uchar red
property uchar green
property uchar blue
element face {faces}
property list uchar int vertex_indices
end_header
"""


def encode_marked_ply(cage: TriMesh, rest: TriMesh | None, marks: tuple[FaultMark, ...]) -> bytes:
    """Encode the cage, then the rest pose if there is one, as binary PLY.

    Returns
    -------
    bytes
        Vertices in the order of the meshes; a vertex has the colour of the first fault that
        concerns it.
    """
    meshes = {"cage": cage} if rest is None else {"cage": cage, "rest": rest}
    points = np.concatenate([mesh.vertices for mesh in meshes.values()])
    colours = [colour_vertices(marks, name, len(mesh.vertices)) for name, mesh in meshes.items()]
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes.values())])
    faces = [mesh.faces + start for mesh, start in zip(meshes.values(), offsets, strict=False)]
    corners = np.concatenate(faces)
    rows = np.zeros(len(points), [("place", "<f8", 3), ("colour", "u1", 3)])
    rows["place"], rows["colour"] = points, np.rint(255 * np.concatenate(colours))
    triangles = np.zeros(len(corners), [("count", "u1"), ("corners", "<i4", 3)])
    triangles["count"], triangles["corners"] = 3, corners
    header = _HEADER.format(
        cage=len(cage.vertices),
        cage_faces=len(cage.faces),
        vertices=len(points),
        faces=len(corners),
    )
    return header.encode() + rows.tobytes() + triangles.tobytes()
