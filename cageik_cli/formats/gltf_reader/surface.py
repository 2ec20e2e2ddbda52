"""Texture coordinates, normals, colours and materials of a mesh in a glTF file."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cageik_cli.formats.base.mesh_data import share_normals
from cageik_cli.formats.gltf_reader.document import Document
from cageik_cli.formats.gltf_reader.geometry import Geometry
from cageik_cli.formats.gltf_reader.items import Item
from cageik_cli.geometry.surface_attributes import SurfaceAttributes, number_normal_fans
from cageik_cli.geometry.surface_parts import (
    MAX_NAME_LENGTH,
    NONE,
    FaceLabels,
    UvMap,
)
from cageik_cli.util.arrays import Integers, Mask
from cageik_cli.util.errors import FormatError
from cageik_cli.util.text import format_count, number_names


class SurfaceReader:
    """Reads the layers of the surface of one mesh."""

    def __init__(self, document: Document, geometry: Geometry) -> None:
        self._document, self._geometry = document, geometry

    def list_layers(self) -> dict[str, Callable[[SurfaceAttributes], SurfaceAttributes]]:
        """Return what reads each layer, for `FileMesh.read_layers`."""
        return {
            "its texture coordinates": self.read_uvs,
            "its normals": self.read_normals,
            "its colours": self.read_colours,
            "its materials": self.read_materials,
        }

    def read_uvs(self, attributes: SurfaceAttributes) -> SurfaceAttributes:
        """Read the first set of texture coordinates, whose v is downward in the file."""
        found = self._geometry.read_attribute("TEXCOORD_0", (2,))
        if found is None:
            return attributes
        held, indices = self._pick_corners(np.asarray(np.isfinite(found).any(axis=1)))
        u, v = found[held].T
        return replace(attributes, uvs=UvMap(np.stack([u, 1 - v], axis=1), indices))

    def read_normals(self, attributes: SurfaceAttributes) -> SurfaceAttributes:
        """Read which corners share a normal."""
        found = self._geometry.read_attribute("NORMAL", (3,))
        if found is None:
            return attributes
        held, indices = self._pick_corners(np.asarray(np.isfinite(found).all(axis=1)))
        shared = share_normals(attributes, found[held], np.where(indices == NONE, 0, indices))
        assert shared.normal_fans is not None
        fans = np.where(indices == NONE, NONE, shared.normal_fans)
        return replace(attributes, normal_fans=number_normal_fans(attributes.corners, fans))

    def read_colours(self, attributes: SurfaceAttributes) -> SurfaceAttributes:
        """Read the colours of vertices."""
        geometry = self._geometry
        found = geometry.read_attribute("COLOR_0", (3, 4))
        if found is None:
            return attributes
        found = np.where(np.isnan(found).all(axis=1, keepdims=True), 1.0, found)
        own = found[geometry.firsts]
        split = (found[geometry.origins] != own[geometry.corners]).any(axis=1)
        if split.any():
            count = format_count(len(np.unique(geometry.corners[split])), "vertex")
            note = f"several colours at {count}, of which one is kept"
            geometry.notes += [] if note in geometry.notes else [note]  # as an instance has it
        return replace(attributes, colours=own)

    def read_materials(self, attributes: SurfaceAttributes) -> SurfaceAttributes:
        """Read the names and base colours of the materials that are used."""
        used, indices = np.unique(self._geometry.materials, return_inverse=True)
        if used[-1] == NONE:
            return attributes
        is_absent = int(used[0] == NONE)
        items = {k: self._document.materials[k] for k in used[is_absent:].tolist()}
        longest = MAX_NAME_LENGTH - 20  # room for a number
        names = [item.read_name()[:longest] or f"material_{k}" for k, item in items.items()]
        labels = FaceLabels(tuple(number_names(names)), indices - is_absent)
        colours = np.array([_read_base_colour(item) for item in items.values()])
        return replace(attributes, materials=labels, material_colours=colours)

    def _pick_corners(self, is_held: Mask) -> tuple[Integers, Integers]:
        """Return the vertices of the pools that corners use and that hold a value, and where.

        The latter are the place of each corner's among them, (3 t,); `NONE` for a corner without.
        """
        origins = self._geometry.origins
        held = np.unique(origins[is_held[origins]])
        places = np.full(len(is_held), NONE)
        places[held] = np.arange(len(held))
        if not len(held):
            raise FormatError("no triangle has them")
        return held, places[origins]


def _read_base_colour(item: Item) -> list[float]:
    """Return linear red, green, blue and opacity."""
    look = item.find_item("pbrMetallicRoughness")
    factor = None if look is None else look.find_numbers("baseColorFactor", 4)
    return [1.0, 1.0, 1.0, 1.0] if factor is None else factor.clip(0, 1).tolist()
