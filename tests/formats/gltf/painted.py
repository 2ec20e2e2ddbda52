"""Triangles with texture coordinates and materials, for tests."""

from dataclasses import replace

import numpy as np

from cageik_cli.geometry.attributes import FaceLabels, UvMap


def paint(mesh, uv=None, material=None, names=()):
    """A mesh of f triangles with UVs (f, 3, 2) and the number of each triangle's material."""
    attributes = mesh.polygons
    if uv is not None:
        uvs = UvMap(uv.reshape(-1, 2), np.arange(mesh.faces.size))
        attributes = replace(attributes, uvs=uvs)
    if material is not None:
        attributes = replace(attributes, materials=FaceLabels(names, material))
    return replace(mesh, attributes=attributes)
