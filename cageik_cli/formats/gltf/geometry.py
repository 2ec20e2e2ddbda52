"""The mesh of a node: primitives are joined, and split vertices welded.

Morph targets and joints move what is welded.
"""

import re
from collections.abc import Iterator, Sequence
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.mesh_data import Change, FileMesh
from cageik_cli.formats.gltf.document import (
    ACCESSORS,
    Document,
    Item,
    Rows,
    SparseRows,
    count_rows,
    make_compression_error,
    read_floats,
    read_integers,
    read_rows,
)
from cageik_cli.formats.gltf.nodes import (
    INFLUENCE_SET_BYTES,
    Influences,
    Skin,
    blend,
    count_influence_sets,
    read_influences,
)
from cageik_cli.geometry.attributes import NONE
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError
from cageik_cli.util.text import group_digits, single_line

TargetMoves = tuple[Integers, NDArray[Any], Integers]
"""Welded vertices (k,), displacements (r, 3) of the file, and which of these they have, (k,)."""

TRIANGLES, STRIP, FAN = 4, 5, 6
"""Modes of primitives that have faces."""

PRIMITIVE_BYTES = 1000
"""Memory of a primitive, besides its numbers."""

_KEPT = re.compile(rf"POSITION|{'|'.join(ACCESSORS.values())}|(JOINTS|WEIGHTS)_\d+")

_DRACO = "KHR_draco_mesh_compression"


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

    def __init__(
        self,
        document: Document,
        attributes: dict[str, int],
        targets: tuple[int | None, ...],
        start: int,
    ) -> None:
        """Count the vertices, which attributes and targets must have alike."""
        self.attributes, self.targets = attributes, targets
        place = attributes["POSITION"]
        size = count_rows(document, place)
        moved = [target for target in targets if target is not None]
        for accessor in (*attributes.values(), *moved):
            found = count_rows(document, accessor)
            if found != size:
                raise FormatError(
                    f"accessors[{accessor}] has {group_digits(found)} vertices, expected "
                    f"{group_digits(size)} as "
                    f"accessors[{place}]; export the file again"
                )
        # Sparse targets are not expanded, but compared vertex by vertex.
        dense = sum(document.accessors[k].has("bufferView") for k in moved)
        document.claim(size * (12 + 12 * dense + len(moved) - dense))
        self.start, self.stop = start, start + size


class Geometry:
    """The primitives of a mesh, joined; vertices that never come apart are one.

    Files split a vertex where its texture coordinates, normals or materials differ. Vertices of
    the same position, joints, weights and displacements, to the bit, are welded. They keep the
    order of the file.

    Attributes
    ----------
    base : (m, 3) float64
        Positions before targets and joints move them.
    corners : (3 t,) int64
        Vertices of the triangles.
    origins : (3 t,) int64
        Vertices of the pools, which have the attributes of these corners.
    materials : (t,) int64
        Numbers of materials, or `NONE`.
    firsts : (m,) int64
        The first vertex of the pools that became each.
    labels : (n,) int64
        The vertex that each vertex of the pools became; -1 if no triangle has it.
    notes : list of Change
        What was changed.
    surfaces : dict
        The mesh and its surface once it was read, by whether it is mirrored: of its first copy.
    """

    def __init__(self, document: Document, item: Item, skin: Skin | None) -> None:
        self._document = document
        self.surfaces: dict[bool, FileMesh] = {}
        self.pools, triangles, materials, self.notes = _read_triangles(document, item)
        is_used = np.zeros(self.pools[-1].stop if self.pools else 0, bool)
        is_used[triangles] = True
        used = np.flatnonzero(is_used)
        positions = self._join(
            [read_floats(document, pool.attributes["POSITION"], (3,)) for pool in self.pools]
        )
        influences = None if skin is None else self._read_influences(len(skin.joints))
        keys = [positions]
        if influences is not None:
            keys += [influences.joints, influences.weights]
        labels = self._refine_by_targets(number_rows([key[used] for key in keys]), used)
        _, first, numbers = np.unique(labels, return_index=True, return_inverse=True)
        order = np.argsort(first)
        self.firsts = used[first[order]]
        self.labels = np.full(len(is_used), -1)
        self.labels[used] = np.argsort(order)[numbers]
        self.base = positions[self.firsts].astype(np.float64)
        faces = self.labels[triangles]
        is_whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        self.corners, self.origins = faces[is_whole].ravel(), triangles[is_whole].ravel()
        self.materials = materials[is_whole]
        if not len(self.corners):
            raise FormatError("has no triangle with three different corners; export the file again")
        self._targets = self._place_targets()
        self._matrix = None if influences is None else influences.make_matrix(self.firsts)
        self._note_changes(is_used, int(np.count_nonzero(~is_whole)))

    @property
    def target_count(self) -> int:
        """How many morph targets there are."""
        return len(self.pools[0].targets) if self.pools else 0

    def evaluate(self, weights: Floats, moves: Floats | None) -> Floats:
        """Return the vertices (m, 3), moved by targets and then by joints.

        Parameters
        ----------
        weights : (K,)
            Of the targets.
        moves : (J, 4, 4), optional
            Of the joints, for a mesh with a skin.
        """
        points = self.base.copy()
        for number, parts in self._targets.items():
            for vertices, rows, picks in parts if weights[number] else ():
                points[vertices] += weights[number] * rows[picks]
        return points if moves is None else blend(points, self._matrix, moves)

    def read_attribute(self, name: str, widths: tuple[int, ...]) -> Floats | None:
        """Return an attribute of all vertices of the pools, (n, width); nan where one lacks it.

        None if all do.
        """
        held = [
            (pool, read_floats(self._document, pool.attributes[name], widths))
            for pool in self.pools
            if name in pool.attributes
        ]
        if not held:
            return None
        found = np.full((len(self.labels), max(rows.shape[1] for _, rows in held)), np.nan)
        for pool, rows in held:
            found[pool.start : pool.stop, : rows.shape[1]] = rows
            found[pool.start : pool.stop, rows.shape[1] :] = 1  # opaque
        return found

    @staticmethod
    def _join(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
        return np.concatenate(arrays) if arrays else np.zeros((0, 3))

    def _read_influences(self, joint_count: int) -> Influences:
        """Read the joints and weights of all vertices of the pools."""
        counts = [count_influence_sets(pool.attributes) for pool in self.pools]
        set_count = max(counts, default=1)
        vertex_count = sum(pool.stop - pool.start for pool in self.pools)
        self._document.claim(vertex_count * set_count * INFLUENCE_SET_BYTES)
        parts = [
            read_influences(self._document, pool.attributes, set_count, pool.stop - pool.start)
            for pool in self.pools
        ]
        joints = self._join([part[0] for part in parts])
        influences = Influences(joints, self._join([part[1] for part in parts]), joint_count)
        self.notes += influences.notes
        return influences

    def _read_target(self, number: int) -> Iterator[tuple[Pool, Rows]]:
        """Yield the pools whose vertices a target moves, and the displacements."""
        for pool in self.pools:
            accessor = pool.targets[number]
            if accessor is not None:
                yield pool, read_rows(self._document, accessor, (3,))

    def _refine_by_targets(self, labels: Integers, used: Integers) -> Integers:
        """Return labels (u,) that differ where a target moves used vertices (u,) apart."""
        first = np.unique(labels, return_index=True)[1]
        for k in self._list_moving_targets():
            self._document.claim(len(used))  # compared, though it moves the vertices of one pool
            moves = np.zeros((len(used), 3))
            for pool, rows in self._read_target(k):
                inside = slice(*np.searchsorted(used, [pool.start, pool.stop]).tolist())
                dense = rows.to_dense() if isinstance(rows, SparseRows) else rows
                moves[inside] = dense[used[inside] - pool.start]
            bits = moves.view(np.int64)
            if (bits != bits[first[labels]]).any():
                labels = number_rows([labels[:, None], moves])
                first = np.unique(labels, return_index=True)[1]
        return labels

    def _list_moving_targets(self) -> list[int]:
        """List the targets that move vertices: files have thousands of others."""
        moved = (
            np.flatnonzero([accessor is not None for accessor in pool.targets])
            for pool in self.pools
        )
        return sorted(set(chain.from_iterable(numbers.tolist() for numbers in moved)))

    def _place_targets(self) -> dict[int, list[TargetMoves]]:
        """Return what targets do to the welded vertices."""
        welded = {}
        for pool in self.pools:
            start, stop = np.searchsorted(self.firsts, [pool.start, pool.stop]).tolist()
            welded[pool] = np.arange(start, stop), self.firsts[start:stop] - pool.start
        placed: dict[int, list[TargetMoves]] = {}
        for number in self._list_moving_targets():
            placed[number] = []
            for pool, rows in self._read_target(number):
                vertices, picks = welded[pool]
                if isinstance(rows, SparseRows):
                    places = np.searchsorted(rows.indices, picks).clip(max=len(rows.indices) - 1)
                    is_moved = rows.indices[places] == picks if len(rows.indices) else picks < 0
                    placed[number].append((vertices[is_moved], rows.values, places[is_moved]))
                else:
                    placed[number].append((vertices, rows, picks))
        return placed

    def _note_changes(self, is_used: NDArray[np.bool_], flat: int) -> None:
        count = int(np.count_nonzero(is_used))
        unused = len(is_used) - count
        if count > len(self.firsts):
            words = (
                "{} welded to others at the same place: they are split where texture "
                "coordinates, normals or materials differ"
            )
            self.notes.append(Change(words, "vertex", count - len(self.firsts)))
        if unused:
            self.notes.append(Change("{} of no triangle left out", "vertex", unused))
        if flat:
            self.notes.append(Change("{} with a corner twice left out", "triangle", flat))


def number_rows(parts: Sequence[NDArray[Any]]) -> Integers:
    """Return equal numbers, from 0 on, for rows that are equal in all parts, (n,), to the bit."""
    bits = [
        np.ascontiguousarray(part + part.dtype.type(0)).view(np.uint8) for part in parts
    ]  # no -0
    rows = np.ascontiguousarray(np.hstack(bits))
    if not rows.size:
        return np.zeros(len(rows), np.int64)
    whole = rows.view(np.dtype((np.void, rows.shape[1]))).ravel()
    return np.unique(whole, return_inverse=True)[1]


def has_faces(mesh: Item) -> bool:
    """Return whether a mesh has a primitive of triangles."""
    return any(map(_is_of_faces, mesh.list_items("primitives")))


def count_targets(mesh: Item) -> int:
    """Return how many morph targets a mesh has."""
    primitives = filter(_has_triangles, mesh.list_items("primitives"))
    return max((len(each.list_items("targets")) for each in primitives), default=0)


def _read_triangles(
    document: Document, mesh: Item
) -> tuple[list[Pool], Integers, Integers, list[Change]]:
    """Read the triangles of all primitives of a mesh, as they are in the file.

    Returns
    -------
    pools, faces, materials, notes
        The vertices that primitives use; triangles of these, (t, 3); the numbers of their
        materials, `NONE` for none, (t,); and what is not read.

    Raises
    ------
    FormatError
        Naming the primitive.
    """
    pools: dict[object, Pool] = {}
    faces, materials = [np.zeros((0, 3), np.int64)], [np.zeros(0, np.int64)]
    primitives = mesh.list_items("primitives")
    document.claim_objects(len(primitives), "primitives", PRIMITIVE_BYTES)
    for primitive in primitives:
        if not _has_triangles(primitive):
            continue
        attributes = primitive.find_item("attributes")
        assert attributes is not None
        pool = _find_pool(document, primitive, attributes, pools)
        faces.append(pool.start + _read_faces(document, primitive, pool.stop - pool.start))
        material = primitive.find_integer("material", len(document.materials))
        materials.append(np.full(len(faces[-1]), NONE if material is None else material))
    if len({len(pool.targets) for pool in pools.values()}) > 1:
        raise FormatError(f"{mesh.place} has primitives of other numbers of morph targets")
    others = len(primitives) + 1 - len(faces)
    notes = [Change("{} without faces left out", "primitive", others)] * (others > 0)
    names = dict.fromkeys(name for pool in pools.values() for name in pool.attributes)
    unread = [name for name in names if not _KEPT.fullmatch(name)]
    notes += [Change("left out {}", names=tuple(map(single_line, unread)))] if unread else []
    return list(pools.values()), np.concatenate(faces), np.concatenate(materials), notes


def _find_pool(document: Document, primitive: Item, item: Item, pools: dict[object, Pool]) -> Pool:
    """Return the vertices of a primitive, which others may share; new ones are added."""
    count = len(document.accessors)
    attributes = {name: item.read_integer(name, count) for name in item.values}
    targets = tuple(
        each.find_integer("POSITION", count) for each in primitive.list_items("targets")
    )
    place = document.accessors[attributes["POSITION"]]
    if primitive.find_extension(_DRACO) and not place.has("bufferView"):
        raise make_compression_error(_DRACO)
    key = tuple(attributes.items()), targets
    if key not in pools:
        last = next(reversed(pools.values()), None)
        pools[key] = Pool(document, attributes, targets, 0 if last is None else last.stop)
    return pools[key]


def _has_triangles(primitive: Item) -> bool:
    """Return whether a primitive is one of those that are read."""
    attributes = primitive.find_item("attributes") if _is_of_faces(primitive) else None
    return attributes is not None and attributes.has("POSITION")


def _is_of_faces(primitive: Item) -> bool:
    return _read_mode(primitive) in (TRIANGLES, STRIP, FAN)


def _read_mode(primitive: Item) -> int:
    mode = primitive.find_integer("mode", 7)
    return TRIANGLES if mode is None else mode


def _read_faces(document: Document, primitive: Item, vertex_count: int) -> Integers:
    """Return the triangles (t, 3) of a primitive, which count its vertices from 0."""
    accessor = primitive.find_integer("indices", len(document.accessors))
    if accessor is None:
        document.claim(8 * vertex_count)
        corners = np.arange(vertex_count)
    else:
        corners = read_integers(document, accessor, 1)[:, 0]
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
