"""A mesh as graphics hardware draws it: triangles whose vertices have one UV and one normal."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface_attributes import NONE
from cageik_cli.util.arrays import Floats, Integers


@dataclass(frozen=True, slots=True, eq=False)
class RenderMesh:
    """Triangles with vertices that are split where UVs or normals are.

    Attributes
    ----------
    vertices : (k,) int64
        The vertex of the mesh of each split vertex, ascending: positions of a frame are
        `frame[vertices]`.
    triangles : (t, 3) int64
        Indices into `vertices`, in the order of the mesh's triangles.
    uvs : (k, 2) float64, optional
        Zero where the mesh has none.
    normal_fans : (k,) int64, optional
        Which of the normals of `compute_fan_normals`; `NONE` for a vertex without.
    materials : (t,) int64
        Which of the names; `NONE` for a triangle without.
    material_names : tuple of str
    """

    vertices: Integers
    triangles: Integers
    uvs: Floats | None
    normal_fans: Integers | None
    materials: Integers
    material_names: tuple[str, ...]


def split_vertices(mesh: TriMesh) -> RenderMesh:
    """Split the vertices of a mesh at the seams of its UVs, and at its hard edges.

    A mesh without attributes keeps its vertices and triangles.
    """
    attributes = mesh.attributes
    if attributes is None:
        vertices = np.arange(len(mesh.vertices))
        bare = np.full(len(mesh.faces), NONE)
        return RenderMesh(vertices, mesh.faces, None, None, bare, ())
    places = find_triangle_corners(mesh)
    keys = [attributes.corners[places]]
    keys += [] if attributes.uvs is None else [attributes.uvs.indices[places]]
    keys += [] if attributes.normal_fans is None else [attributes.normal_fans[places]]
    rows = np.stack([key.ravel() for key in keys], axis=1)
    split, first, number = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    corner = places.ravel()[first]
    uvs = None
    if attributes.uvs is not None:
        chosen = attributes.uvs.indices[corner]
        padded = np.concatenate([attributes.uvs.values, np.zeros((1, 2))])  # `NONE` is the last
        uvs = padded[chosen]
    labels = attributes.materials
    return RenderMesh(
        vertices=split[:, 0],
        triangles=number.reshape(-1, 3),
        uvs=uvs,
        normal_fans=None if attributes.normal_fans is None else attributes.normal_fans[corner],
        materials=np.full(len(mesh.faces), NONE)
        if labels is None
        else labels.indices[attributes.triangle_polygons],
        material_names=() if labels is None else labels.names,
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
