"""The surface of a mesh as glTF has it: vertices with one UV each, a primitive per material."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from cageik_cli.formats.gltf.glb_file import GlbFile, Singles
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.triangle_attributes import cut_attributes
from cageik_cli.util.arrays import Floats, Integers


@dataclass(frozen=True, slots=True)
class Material:
    """A material without textures.

    Attributes
    ----------
    name : str
    base_colour : tuple of 4 float
        Red, green, blue, linear, and opacity; 0 to 1.
    """

    name: str
    base_colour: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)


PLAIN = Material("plain")
"""Of a mesh without materials: glTF's own default is a metal, black where nothing is mirrored."""


@dataclass(frozen=True, slots=True, eq=False)
class Appearance:
    """What colours a mesh of f triangles.

    Attributes
    ----------
    uv : (f, 3, 2) float, optional
        Of each corner, with v upward, as OBJ and USD have it; uv of vertices are `uv[faces]`.
    material : (f,) int, optional
        Index of each triangle's material, -1 for none; the first if absent.
    materials : tuple of Material
    """

    uv: Floats | None = None
    material: Integers | None = None
    materials: tuple[Material, ...] = (PLAIN,)


def find_appearance(mesh: TriMesh) -> Appearance:
    """Return what the attributes of a mesh say of its triangles."""
    cut = cut_attributes(mesh)
    if cut.materials is None:
        return Appearance(cut.uvs)
    return Appearance(cut.uvs, cut.materials, tuple(map(Material, cut.material_names)))


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Vertices `start` to `stop`, and their triangles (f, 3), counted from `start`."""

    material: int
    start: int
    stop: int
    faces: Integers


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A mesh cut into one part per material.

    Attributes
    ----------
    origins : (m',) int64
        Number of each written vertex in the mesh; seams are written once per side.
    uv : (m', 2) float32, optional
        With v downward, as glTF has it.
    parts : tuple of Part
        In the order of the vertices.
    materials : tuple of Material
    """

    origins: Integers
    uv: Singles | None
    parts: tuple[Part, ...]
    materials: tuple[Material, ...]

    def make_materials(self) -> list[object]:
        """Return the materials as pygltflib has them."""
        import pygltflib as gltf

        return [
            gltf.Material(
                name=material.name,
                alphaMode=gltf.BLEND if material.base_colour[3] < 1 else gltf.OPAQUE,
                pbrMetallicRoughness=gltf.PbrMetallicRoughness(
                    baseColorFactor=list(material.base_colour), metallicFactor=0, roughnessFactor=1
                ),
            )
            for material in self.materials
        ]

    def make_primitive(self, file: GlbFile, part: Part, attributes: dict[str, int]) -> Any:
        """Write the triangles and UVs of a part, and return its primitive."""
        import pygltflib as gltf

        corners = part.faces.astype(np.uint32).ravel()
        indices = file.add_array(corners, gltf.ELEMENT_ARRAY_BUFFER)
        if self.uv is not None:
            uv = self.uv[part.start : part.stop]
            attributes = {**attributes, "TEXCOORD_0": file.add_array(uv, gltf.ARRAY_BUFFER)}
        return gltf.Primitive(
            attributes=gltf.Attributes(**attributes), indices=indices, material=part.material
        )


def cut_surface(faces: Integers, vertex_count: int, look: Appearance) -> Surface:
    """Cut a mesh into parts of one material, whose vertices have one UV each.

    A mesh with one material and no UVs keeps its vertices and their order. Otherwise vertices are
    those of the triangles, ordered by material, number and UV.

    Parameters
    ----------
    faces : (f, 3)
    vertex_count : int
    look : Appearance
    """
    if look.uv is None and look.material is None:
        whole = Part(0, 0, vertex_count, faces)
        return Surface(np.arange(vertex_count), None, (whole,), look.materials)
    material = np.zeros(len(faces), np.int64) if look.material is None else look.material
    materials = look.materials
    if (material < 0).any():
        material = np.where(material < 0, len(materials), material)
        materials = (*materials, PLAIN)
    keys = np.stack([np.repeat(material, 3), faces.ravel(), np.zeros(faces.size, np.int64)], axis=1)
    values = None
    if look.uv is not None:
        values, keys[:, 2] = np.unique(look.uv.reshape(-1, 2), axis=0, return_inverse=True)
    kept, numbers = np.unique(keys, axis=0, return_inverse=True)
    cut = numbers.reshape(-1, 3)
    parts = []
    for index in np.unique(material).tolist():
        start, stop = np.searchsorted(kept[:, 0], [index, index + 1]).tolist()
        parts.append(Part(index, start, stop, cut[material == index] - start))
    uv = None if values is None else _flip_v(values[kept[:, 2]])
    return Surface(kept[:, 1], uv, tuple(parts), materials)


def _flip_v(uv: Floats) -> Singles:
    """Return UVs (k, 2) with v downward."""
    return np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1).astype(np.float32)
