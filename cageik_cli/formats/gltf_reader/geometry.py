"""The mesh of a node: split vertices are welded, which targets and joints move."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.gltf_reader.accessors import Rows, SparseRows, read_floats, read_rows
from cageik_cli.formats.gltf_reader.document import Document
from cageik_cli.formats.gltf_reader.items import Item
from cageik_cli.formats.gltf_reader.primitives import Pool, Triangles
from cageik_cli.formats.gltf_reader.skins import (
    INFLUENCE_SET_BYTES,
    Influences,
    Skin,
    blend,
    count_influence_sets,
    read_influences,
)
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError
from cageik_cli.util.text import format_count

TargetMoves = tuple[Integers, NDArray[Any], Integers]
"""Welded vertices (k,), displacements (r, 3) of the file, and which of these they have, (k,)."""


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
    notes : list of str
        What was changed.
    """

    def __init__(self, document: Document, item: Item, skin: Skin | None) -> None:
        self._document = document
        triangles = Triangles(document, item)
        self.pools, self.notes = list(triangles.pools.values()), triangles.notes
        is_used = np.zeros(triangles.vertex_count, bool)
        is_used[triangles.faces] = True
        used = np.flatnonzero(is_used)
        positions = self._join([read_floats(document, k, (3,)) for k in self._list("POSITION")])
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
        faces = self.labels[triangles.faces]
        is_whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        self.corners, self.origins = faces[is_whole].ravel(), triangles.faces[is_whole].ravel()
        self.materials = triangles.materials[is_whole]
        if not len(self.corners):
            raise FormatError("has no triangle with three different corners; export the file again")
        self._targets = [list(self._place_target(k)) for k in range(self.target_count)]
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
        for weight, parts in zip(weights, self._targets, strict=True):
            for vertices, rows, picks in parts if weight else ():
                points[vertices] += weight * rows[picks]
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

    def _list(self, name: str) -> list[int]:
        return [pool.attributes[name] for pool in self.pools]

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
        for k in range(self.target_count):
            first = np.unique(labels, return_index=True)[1]
            moves = np.zeros((len(used), 3))
            for pool, rows in self._read_target(k):
                inside = slice(*np.searchsorted(used, [pool.start, pool.stop]).tolist())
                dense = rows.to_dense() if isinstance(rows, SparseRows) else rows
                moves[inside] = dense[used[inside] - pool.start]
            bits = moves.view(np.int64)
            if (bits != bits[first[labels]]).any():
                labels = number_rows([labels[:, None], moves])
        return labels

    def _place_target(self, number: int) -> Iterator[TargetMoves]:
        """Yield what a target does to the welded vertices."""
        for pool, rows in self._read_target(number):
            start, stop = np.searchsorted(self.firsts, [pool.start, pool.stop]).tolist()
            vertices, picks = np.arange(start, stop), self.firsts[start:stop] - pool.start
            if isinstance(rows, SparseRows):
                places = np.searchsorted(rows.indices, picks).clip(max=len(rows.indices) - 1)
                is_moved = rows.indices[places] == picks if len(rows.indices) else picks < 0
                yield vertices[is_moved], rows.values, places[is_moved]
            else:
                yield vertices, rows, picks

    def _note_changes(self, is_used: NDArray[np.bool_], flat: int) -> None:
        count = int(np.count_nonzero(is_used))
        unused = len(is_used) - count
        if count > len(self.firsts):
            self.notes.append(
                f"{count} vertices, split where texture coordinates, normals or materials differ, "
                f"welded to {len(self.firsts)}"
            )
        if unused:
            self.notes.append(f"{format_count(unused, 'vertex')} of no triangle left out")
        if flat:
            self.notes.append(f"{format_count(flat, 'triangle')} with a corner twice left out")


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
