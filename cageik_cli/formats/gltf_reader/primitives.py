"""Primitives: which vertices they use, and the triangles between these."""

import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from cageik_cli.formats.gltf_reader.accessors import count_rows, read_wholes
from cageik_cli.formats.gltf_reader.document import Document, make_compression_error
from cageik_cli.formats.gltf_reader.items import Item
from cageik_cli.geometry.surface_parts import NONE
from cageik_cli.util.arrays import Integers
from cageik_cli.util.errors import FormatError, join_truncated
from cageik_cli.util.text import format_count, single_line

TRIANGLES, STRIP, FAN = 4, 5, 6
"""Modes of primitives that have faces."""

_KEPT = re.compile(r"POSITION|NORMAL|TEXCOORD_0|COLOR_0|(JOINTS|WEIGHTS)_\d+")

_DRACO = "KHR_draco_mesh_compression"


@dataclass(frozen=True, slots=True, eq=False)
class Pool:
    """Vertices that one or several primitives use.

    Attributes
    ----------
    attributes : dict
        Numbers of accessors by name: POSITION.
    targets : tuple of int or None
        Of the displacements of each morph target; None for one that moves none of the vertices.
    start, stop : int
        Numbers of the first vertex, and of that behind the last, among those of the mesh.
    """

    attributes: dict[str, int]
    targets: tuple[int | None, ...]
    start: int
    stop: int


def has_faces(mesh: Item) -> bool:
    """Return whether a mesh has a primitive of triangles."""
    return any(map(_is_of_faces, mesh.list_items("primitives")))


def count_targets(mesh: Item) -> int:
    """Return how many morph targets a mesh has."""
    primitives = mesh.list_items("primitives")
    return max((len(each.list_items("targets")) for each in primitives), default=0)


class Triangles:
    """The triangles of all primitives of a mesh, as they are in the file.

    Attributes
    ----------
    pools : dict
        The vertices that primitives use, by what they refer to.
    vertex_count : int
        How many vertices the pools have.
    faces : (t, 3) int64
        Vertices of the pools.
    materials : (t,) int64
        Numbers of materials; `NONE` for none.
    notes : list of str
        What is not read.

    Raises
    ------
    FormatError
        Naming the primitive.
    """

    def __init__(self, document: Document, mesh: Item) -> None:
        self.pools: dict[object, Pool] = {}
        self.vertex_count = 0
        faces = [np.zeros((0, 3), np.int64)]
        materials = [np.zeros(0, np.int64)]
        primitives = mesh.list_items("primitives")
        for primitive in primitives:
            if not (_is_of_faces(primitive) and _has_positions(primitive)):
                continue
            pool = self._find_pool(document, primitive)
            faces.append(pool.start + _read_faces(document, primitive, pool.stop - pool.start))
            material = primitive.find_whole("material", len(document.materials))
            materials.append(np.full(len(faces[-1]), NONE if material is None else material))
        if len({len(pool.targets) for pool in self.pools.values()}) > 1:
            raise FormatError(f"{mesh.place} has primitives of other numbers of morph targets")
        self.faces, self.materials = np.concatenate(faces), np.concatenate(materials)
        others = len(primitives) + 1 - len(faces)
        self.notes = [f"{format_count(others, 'primitive')} without faces left out"] * (others > 0)
        self.notes += _describe_unread(self.pools.values())

    def _find_pool(self, document: Document, primitive: Item) -> Pool:
        """Return the vertices of a primitive, which others may share; new ones are added."""
        count = len(document.accessors)
        item = primitive.find_item("attributes")
        assert item is not None
        attributes = {name: item.read_whole(name, count) for name in item.values}
        targets = tuple(
            each.find_whole("POSITION", count) for each in primitive.list_items("targets")
        )
        place = document.accessors[attributes["POSITION"]]
        if primitive.find_extension(_DRACO) and not place.has("bufferView"):
            raise make_compression_error(_DRACO)
        key = tuple(attributes.items()), targets
        if key not in self.pools:
            start, size = self.vertex_count, _claim_vertices(document, attributes, targets)
            self.vertex_count += size
            self.pools[key] = Pool(attributes, targets, start, self.vertex_count)
        return self.pools[key]


def _is_of_faces(primitive: Item) -> bool:
    return _read_mode(primitive) in (TRIANGLES, STRIP, FAN)


def _read_mode(primitive: Item) -> int:
    mode = primitive.find_whole("mode", 7)
    return TRIANGLES if mode is None else mode


def _has_positions(primitive: Item) -> bool:
    attributes = primitive.find_item("attributes")
    return attributes is not None and attributes.has("POSITION")


def _claim_vertices(
    document: Document, attributes: dict[str, int], targets: Iterable[int | None]
) -> int:
    """Return how many vertices attributes and targets have, which is the same for all."""
    place = attributes["POSITION"]
    size = count_rows(document, place)
    moved = [target for target in targets if target is not None]
    for accessor in (*attributes.values(), *moved):
        found = count_rows(document, accessor)
        if found != size:
            raise FormatError(
                f"accessors[{accessor}] has {found} vertices, expected {size} as "
                f"accessors[{place}]; export the file again"
            )
    # Sparse targets are not expanded, but compared vertex by vertex.
    dense = sum(document.accessors[k].has("bufferView") for k in moved)
    document.claim(size * (12 + 12 * dense + len(moved) - dense))
    return size


def _read_faces(document: Document, primitive: Item, vertex_count: int) -> Integers:
    """Return the triangles (t, 3) of a primitive, which count its vertices from 0."""
    accessor = primitive.find_whole("indices", len(document.accessors))
    if accessor is None:
        document.claim(8 * vertex_count)
        corners = np.arange(vertex_count)
    else:
        corners = read_wholes(document, accessor, 1)[:, 0]
        if corners.max() >= vertex_count:
            raise FormatError(
                f"{primitive.locate('indices')} name vertex {corners.max()}, expected 0 to "
                f"{vertex_count - 1}; export the file again"
            )
    mode, count = _read_mode(primitive), len(corners)
    if count < 3 or (mode == TRIANGLES and count % 3):
        wanted = "a multiple of 3" if mode == TRIANGLES else "3 or more"
        raise FormatError(
            f"{primitive.place} has {count} corners, expected {wanted}; export the file again"
        )
    if mode == TRIANGLES:
        return corners.reshape(-1, 3)
    document.claim(16 * count)
    k = np.arange(count - 2)
    if mode == FAN:
        return np.stack([corners[1:-1], corners[2:], np.full(count - 2, corners[0])], axis=1)
    odd = k % 2  # every second triangle of a strip turns the other way
    return np.stack([corners[k], corners[k + 1 + odd], corners[k + 2 - odd]], axis=1)


def _describe_unread(pools: Iterable[Pool]) -> list[str]:
    """Return a note on the attributes that are not kept."""
    names = dict.fromkeys(name for pool in pools for name in pool.attributes)
    unread = [name for name in names if not _KEPT.fullmatch(name)]
    return [f"left out {join_truncated(map(single_line, unread))}"] if unread else []
