"""The surface of a mesh in glTF: one UV and normal per vertex, a primitive per material.

It is read from the geometry of a node, and written cut into primitives.
"""

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.mesh_data import Change, LayerReaders, list_layer_readers
from cageik_cli.formats.gltf.document import ACCESSORS, Document
from cageik_cli.formats.gltf.file import GlbFile, Singles, round_to
from cageik_cli.formats.gltf.geometry import Geometry
from cageik_cli.geometry.attributes import (
    LAYERS,
    MAX_NAME_LENGTH,
    NONE,
    PLAIN_COLOUR,
    FaceLabels,
    SurfaceAttributes,
    UvMap,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import split_parts
from cageik_cli.geometry.shape import (
    FALLBACK_NORMAL,
    complete_fans,
    compute_fan_normals,
    compute_vertex_normals,
)
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError
from cageik_cli.util.text import number_names

PLAIN = "plain"
"""The material of triangles without: glTF's own is a metal, black where nothing is mirrored."""

MAX_SHORT_VERTICES = 65535
"""Vertices that indices of 16 bits can name; the last number restarts a strip."""


def list_surface_layers(document: Document, geometry: Geometry) -> LayerReaders:
    """Return what reads UVs, normals, colours and materials of a mesh."""
    readers = list_layer_readers(ACCESSORS, partial(_read_layer, geometry))
    return readers | {"its materials": partial(_read_materials, document, geometry)}


def _read_layer(geometry: Geometry, name: str, attributes: SurfaceAttributes) -> SurfaceAttributes:
    """Read a layer that an accessor holds."""
    layer = LAYERS[name]
    is_of_vertices = layer.domain == "vertex"
    widths = (layer.width - 1, layer.width) if is_of_vertices else (layer.width,)
    found = geometry.read_attribute(ACCESSORS[name], widths)
    if found is None:
        return attributes
    if is_of_vertices:
        found = np.where(np.isnan(found).all(axis=1, keepdims=True), 1.0, found)
        own = found[geometry.firsts]
        split = (found[geometry.origins] != own[geometry.corners]).any(axis=1)
        if split.any():
            count = len(np.unique(geometry.corners[split]))
            note = Change(f"several {layer.noun} at {{}}, of which one is kept", "vertex", count)
            geometry.notes += [] if note in geometry.notes else [note]  # as an instance has it
        return attributes.add_layer(name, own)
    is_held = np.isfinite(found).sum(axis=1) >= (3 if name == "normal_fans" else 1)
    held = np.unique(geometry.origins[is_held[geometry.origins]])
    if not len(held):
        raise FormatError("no triangle has them")
    values, places = found[held], np.full(len(found), NONE)
    places[held] = np.arange(len(held))
    if name == "uvs":
        values[:, 1] = 1 - values[:, 1]  # downward in the file
    return attributes.add_layer(name, values, places[geometry.origins])


def _read_materials(
    document: Document, geometry: Geometry, attributes: SurfaceAttributes
) -> SurfaceAttributes:
    """Read the names and base colours of the materials that are used."""
    used, indices = np.unique(geometry.materials, return_inverse=True)
    if used[-1] == NONE:
        return attributes
    is_absent = int(used[0] == NONE)
    items = {k: document.materials[k] for k in used[is_absent:].tolist()}
    longest = MAX_NAME_LENGTH - 20  # room for a number
    names = [item.read_name()[:longest] or f"material_{k}" for k, item in items.items()]
    labels = FaceLabels(tuple(number_names(names)), indices - is_absent)
    colours = np.ones((len(items), 4))  # linear red, green, blue and opacity
    for colour, item in zip(colours, items.values(), strict=True):
        look = item.find_item("pbrMetallicRoughness")
        factor = None if look is None else look.find_numbers("baseColorFactor", 4)
        if factor is not None:
            colour[:] = factor.clip(0, 1)
    return replace(attributes, materials=labels, material_colours=colours)


@dataclass(frozen=True, slots=True, eq=False)
class Primitive:
    """Vertices `start` to `stop` of one part, and their triangles (f, 3), counted from `start`."""

    part: int
    material: int
    start: int
    stop: int
    faces: Integers


@dataclass(frozen=True, eq=False)
class Surface:
    """A mesh cut into primitives: one per part and material.

    Attributes
    ----------
    origins : (m',) int64
        Number of each written vertex in the mesh; seams and hard edges are written once per side.
    layers : dict
        UVs, with v downward, and colours, (m', width) float32, of the written vertices.
    fans : (m',) int64, optional
        Which of the normals of the completed fans of the mesh; that of the vertex if absent.
    primitives : tuple of Primitive
        In the order of the vertices.
    base_colours : (k, 4) float64
        Of the materials: linear red, green, blue and opacity.
    """

    mesh: TriMesh
    origins: Integers
    layers: dict[str, Singles]
    fans: Integers | None
    primitives: tuple[Primitive, ...]
    materials: tuple[str, ...]
    base_colours: Floats

    @cached_property
    def _shaded(self) -> SurfaceAttributes:
        polygons = self.mesh.polygons
        return polygons if self.fans is None else complete_fans(polygons)

    def compute_normals(self, positions: Floats) -> Floats:
        """Compute the normals (m', 3) of the written vertices, for positions (m, 3) of the mesh."""
        if self.fans is None:
            normals = compute_vertex_normals(self._shaded, positions)
            normals[~normals.any(axis=1)] = FALLBACK_NORMAL  # glTF wants a length of 1
            return normals[self.origins]
        return compute_fan_normals(self._shaded, positions)[self.fans]

    def make_materials(self) -> list[object]:
        """Return the materials as pygltflib has them."""
        import pygltflib as gltf

        colours = self.layers.get("colours")
        is_clear = colours is not None and colours.shape[1] == 4 and bool((colours[:, 3] < 1).any())
        # White where vertices have colours, which are multiplied by it.
        factors = [[1.0, 1.0, 1.0, 1.0]] * len(self.materials)
        if colours is None:
            factors = self.base_colours.clip(0, 1).tolist()
        return [
            gltf.Material(
                name=name,
                alphaMode=gltf.BLEND if is_clear or factor[3] < 1 else gltf.OPAQUE,
                pbrMetallicRoughness=gltf.PbrMetallicRoughness(
                    baseColorFactor=factor, metallicFactor=0, roughnessFactor=1
                ),
            )
            for name, factor in zip(self.materials, factors, strict=True)
        ]

    def write_primitive(
        self,
        file: GlbFile,
        primitive: Primitive,
        attributes: dict[str, int],
        *,
        is_quantized: bool = False,
    ) -> Any:
        """Write the triangles, UVs and colours of a primitive, and return it as pygltflib's.

        If it is quantized, they take 16 bits where that is enough.
        """
        import pygltflib as gltf

        is_short = is_quantized and primitive.stop - primitive.start <= MAX_SHORT_VERTICES
        corners = primitive.faces.astype(np.uint16 if is_short else np.uint32).ravel()
        indices = file.add_array(corners, gltf.ELEMENT_ARRAY_BUFFER)
        for name, values in self.layers.items():
            rows: NDArray[Any] = values[primitive.start : primitive.stop]
            is_small = is_quantized and rows.min() >= 0 and rows.max() <= 1
            if is_small:
                rows = round_to(rows.astype(np.float64), np.uint16)
            number = file.add_array(rows, gltf.ARRAY_BUFFER, is_normalized=is_small)
            attributes = {**attributes, ACCESSORS[name]: number}
        return gltf.Primitive(
            attributes=gltf.Attributes(**attributes), indices=indices, material=primitive.material
        )


def cut_surface(mesh: TriMesh, has_normals: bool) -> Surface:
    """Cut a mesh into primitives, whose vertices have one UV and one normal each.

    A mesh with one material and no UVs or normals keeps its vertices and their order. Otherwise
    vertices are those of the triangles, ordered by part, material, number, normal and UV. With
    normals, the vertices of hard edges are parted.
    """
    polygons = mesh.polygons
    labels, fans = polygons.materials, None
    maps = {name: held for name in ACCESSORS if isinstance(held := getattr(polygons, name), UvMap)}
    if has_normals and polygons.normal_fans is not None:
        fans = complete_fans(polygons).normal_fans
    if not maps and labels is None and fans is None:
        wholes = tuple(
            Primitive(k, 0, part.vertices.start, part.vertices.stop, part.mesh.faces)
            for k, part in enumerate(split_parts(mesh))
        )
        plain, origins = np.array([PLAIN_COLOUR]), np.arange(len(mesh.vertices))
        layers = _take_vertex_layers(polygons, origins)
        return Surface(mesh, origins, layers, None, wholes, (PLAIN,), plain)
    corners, (material, materials) = _find_triangle_corners(mesh), _complete_materials(polygons)
    owners = [np.full(len(part.mesh.faces), k) for k, part in enumerate(split_parts(mesh))]
    place = np.concatenate(owners) * len(materials) + material
    keys = np.zeros((mesh.faces.size, 3 + len(maps)), np.int64)
    keys[:, 0], keys[:, 1] = np.repeat(place, 3), mesh.faces.ravel()
    if fans is not None:
        keys[:, 2] = fans[corners].ravel()
    tables = {}
    for column, (name, held) in enumerate(maps.items(), start=3):
        values, indices = held.complete()
        found = values[indices[corners]].reshape(-1, values.shape[1])
        tables[name], keys[:, column] = np.unique(found, axis=0, return_inverse=True)
    kept, numbers = np.unique(keys, axis=0, return_inverse=True)
    cut = numbers.reshape(-1, 3)
    primitives = []
    for number in np.unique(place).tolist():
        start, stop = np.searchsorted(kept[:, 0], [number, number + 1]).tolist()
        part, index = divmod(number, len(materials))
        primitives.append(Primitive(part, index, start, stop, cut[place == number] - start))
    if "uvs" in tables:
        tables["uvs"][:, 1] = 1 - tables["uvs"][:, 1]
    layers = {
        name: table[kept[:, column]].astype(np.float32)
        for column, (name, table) in enumerate(tables.items(), start=3)
    }
    colours = np.tile(PLAIN_COLOUR, (len(materials), 1))
    if labels is not None and polygons.material_colours is not None:
        colours[: len(labels.names)] = polygons.material_colours
    return Surface(
        mesh=mesh,
        origins=kept[:, 1],
        layers=layers | _take_vertex_layers(polygons, kept[:, 1]),
        fans=None if fans is None else kept[:, 2],
        primitives=tuple(primitives),
        materials=materials,
        base_colours=colours,
    )


def _take_vertex_layers(polygons: SurfaceAttributes, origins: Integers) -> dict[str, Singles]:
    """Return what vertices have, from 0 to 1, of some of them: colours."""
    names = [name for name in ACCESSORS if LAYERS[name].domain == "vertex"]
    held = {name: getattr(polygons, name) for name in names}
    return {
        name: values[origins].clip(0, 1).astype(np.float32)
        for name, values in held.items()
        if values is not None
    }


def _find_triangle_corners(mesh: TriMesh) -> Integers:
    """Find the corners of the polygons that the corners of the triangles are, (t, 3).

    A polygon that has a vertex twice gives the first of its corners there.
    """
    attributes, size = mesh.polygons, len(mesh.vertices)
    keys = attributes.corner_polygons * size + attributes.corners
    order = np.argsort(keys, kind="stable")
    wanted = attributes.triangle_polygons[:, None] * size + mesh.faces
    return np.asarray(order[np.searchsorted(keys[order], wanted)])


def _complete_materials(polygons: SurfaceAttributes) -> tuple[Integers, tuple[str, ...]]:
    """Return the material of each triangle, (t,), and all names; that of some may be plain."""
    labels, owners = polygons.materials, polygons.triangle_polygons
    if labels is None:
        return np.zeros(len(owners), np.int64), (PLAIN,)
    found = labels.indices[owners]
    if (found >= 0).all():
        return found, labels.names
    return np.where(found < 0, len(labels.names), found), (*labels.names, PLAIN)
