"""A model made small: fewer vertices, weights as integers, differences, arrays as one text.

Rounding weights loses little where a cage is known. But a pose solves for the cage by rows of the
weights, and amplifies errors of these in the smooth motions of the cage, which cost little energy.
So what rounding loses there is kept, too: one byte per vertex and motion.

Weights and errors are smooth over a surface: the numbers of a vertex are near the mean of those of
its neighbours that come before it. Where they are all on one side this mean lacks about as much as
the neighbours' own did, so that half of that is added. What is left is small, and its sign is
stored in the lowest bit, so that the higher bytes are nearly always zero.

The text is base64 of gzip of: the length of the header (4 bytes, little-endian), the header as
JSON, and the arrays, one after another. The header lists them under `arrays`. The bytes of an array
are stored by place: the first bytes of all numbers, then the second ones. That packs better.
"""

import base64
import json
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import uniform_laplacian
from cageik_cli.util.arrays import Floats, Integers

MAX_LEVEL = 20_000
"""Largest integer a weight is rounded to. Clips of a dance are drawn to 7e-6 diagonals (rms)."""

SMALL_MAX_LEVEL = 2_000
"""Largest integer a weight of a small page is rounded to; see `MAX_LEVEL`.

Clips of a dance are then drawn to 7e-5 diagonals (rms), which is less than a tenth of a pixel.
"""

PACKED_TYPES = {"f4": "<f4", "i1": "|i1", "i2": "<i2", "u1": "|u1", "u2": "<u2", "u4": "<u4"}
"""Types of numbers in packed arrays, by their names in the header."""

MAX_SMOOTH_MOTIONS = 12
"""Smooth motions of a cage in which the rounding of weights is made good, at most."""


def decimate(mesh: TriMesh, max_vertices: int) -> tuple[Integers, Integers]:
    """Keep at most `max_vertices` vertices of a mesh, one per cell of a grid.

    Vertices are not moved, so that weights of the mesh are weights of the coarse one. Faces of
    which two corners fall together are left out. Vertices that no face uses are left out too.

    Returns
    -------
    vertices : (k,) int64
        Their numbers in the mesh, ascending.
    faces : (t, 3) int64
        Indices into `vertices`.
    """
    used = np.unique(mesh.faces)
    if len(used) <= max_vertices:
        return used, np.searchsorted(used, mesh.faces)
    points = mesh.vertices[used]
    points = (points - points.min(axis=0)) / (mesh.diagonal or 1.0)
    size = 1 / np.sqrt(max_vertices)  # too small: a surface of m cells of this size is that large
    cells = _find_cells(points, size)
    while cells.max() >= max_vertices:
        size *= 1.1
        cells = _find_cells(points, size)
    # The point of each cell that is closest to the mean of its points.
    counts = np.bincount(cells)
    means = np.stack([np.bincount(cells, weights=axis) for axis in points.T], axis=1)
    distances = np.linalg.norm(points - (means / counts[:, None])[cells], axis=1)
    by_cell = np.lexsort((distances, cells))
    chosen = by_cell[np.searchsorted(cells[by_cell], np.arange(len(counts)))]
    corners = cells[np.searchsorted(used, mesh.faces)]
    is_kept = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    # Faces are turned so that the smallest corner is first: the same face is then kept once.
    kept = corners[is_kept]
    turned = np.take_along_axis(kept, (kept.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    order = np.argsort(used[chosen])
    number = np.empty(len(order), np.int64)
    number[order] = np.arange(len(order))
    return used[chosen[order]], number[np.unique(turned, axis=0)].reshape(-1, 3)


def _find_cells(points: Floats, size: float) -> Integers:
    """Return the number of each point's cell, counted from 0 without gaps."""
    places = np.floor(points / size).astype(np.int64)
    width = places.max() + 1
    keys = (places[:, 0] * width + places[:, 1]) * width + places[:, 2]
    return np.asarray(np.unique(keys, return_inverse=True)[1].reshape(-1))


@dataclass(frozen=True, slots=True, eq=False)
class RoundedWeights:
    """Weights: `integers / levels + rest_step * rests @ motions.T`.

    Attributes
    ----------
    integers : (m, n) int16
    levels : float
        The number of steps in a weight of one.
    motions : (n, q) float64
        Orthonormal motions of one coordinate of the cage.
    rests : (m, q) int8
        What rounding lost in these motions,
    rest_step : float
        in steps of this size.
    """

    integers: NDArray[np.int16]
    levels: float
    motions: Floats
    rests: NDArray[np.int8]
    rest_step: float

    def restore(self) -> Floats:
        """Return the weights, (m, n)."""
        return np.asarray(
            self.integers / self.levels + self.rest_step * self.rests @ self.motions.T
        )


def find_smooth_motions(cage: TriMesh) -> Floats:
    """Return the smoothest motions of a cage that are not that of the whole, (n, q)."""
    laplacian = uniform_laplacian(cage)
    vectors = np.linalg.eigh(laplacian.T @ laplacian)[1][:, : 1 + MAX_SMOOTH_MOTIONS]
    signs = np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(vectors.shape[1])])
    return np.asarray((vectors * signs)[:, 1:])


def round_weights(
    weights: Floats, motions: Floats, max_level: int = MAX_LEVEL, rows_per_block: int = 4096
) -> RoundedWeights:
    """Round weights (m, n), finite, of any sign, so that their rows keep their sums.

    The integers of a row whose sum is one have the sum `levels`, which is then a whole number: a
    cage that moves as one moves the mesh exactly so, however far. They are for displacements of a
    cage, so that the rest pose is exact. Rows are rounded in blocks, so that memory does not grow
    with the model.
    """
    max_rest = 127
    top = float(np.abs(weights).max(initial=0.0)) or 1.0
    levels = max_level / top
    levels = float(np.floor(levels)) if levels >= 1 else levels
    integers = np.empty(weights.shape, np.int16)
    for start in range(0, len(weights), rows_per_block):
        rows = slice(start, start + rows_per_block)
        integers[rows] = _round_rows(weights[rows] * levels)
    lost = weights @ motions - integers @ motions / levels
    step = float(np.abs(lost).max(initial=0.0)) / max_rest or 1.0
    return RoundedWeights(integers, levels, motions, np.rint(lost / step).astype(np.int8), step)


def _round_rows(values: Floats) -> Floats:
    """Round rows to integers whose sums are the rounded sums, by the largest remainders."""
    rounded = np.rint(values)
    missing = np.rint(values.sum(axis=1)) - rounded.sum(axis=1)
    wanted = np.sign(missing)[:, None] * (values - rounded)
    places = np.argsort(-wanted, axis=1, kind="stable")
    is_changed = np.arange(values.shape[1]) < np.abs(missing)[:, None]
    changes = np.zeros_like(values)
    np.put_along_axis(changes, places, is_changed * np.sign(missing)[:, None], axis=1)
    return np.asarray(rounded + changes)


class Predictor:
    """Predicts the numbers of a vertex from the vertices before it.

    That is the mean over the corners of its faces that come before it, rounded down, or else the
    number of the vertex before it; 0 for the first.
    """

    def __init__(self, faces: Integers, count: int) -> None:
        """Prepare for the faces, (t, 3), of a mesh of `count` vertices."""
        corners = np.concatenate([np.roll(faces, turn, axis=1).ravel() for turn in (1, 2)])
        own = np.concatenate([faces.ravel()] * 2)
        is_before = corners < own
        entries = (np.ones(is_before.sum(), np.int64), (own[is_before], corners[is_before]))
        self._before = csr_array(entries, shape=(count, count))
        self._counts = np.asarray(self._before.sum(axis=1)).reshape(-1)

    def encode(self, values: NDArray[np.int16]) -> NDArray[np.int16]:
        """Return what the prediction lacks, of the same shape; the last axis is that of vertices.

        A difference d is stored as 2 d, or -2 d - 1 if it is negative, in 16 bits without a sign.
        Larger numbers begin again, as sums of 16 bits do.
        """
        encoded = np.empty_like(values)
        for place in np.ndindex(values.shape[:-1]):
            row = values[place]
            lack = row - self._average(row)
            left = lack - (self._average(lack) >> 1)
            encoded[place] = (left << 1) ^ (left >> 15)
        return encoded

    def _average(self, row: NDArray[np.int16]) -> NDArray[np.int16]:
        """Return the mean of the vertices before each one, (m,)."""
        means = (self._before @ row.astype(np.int64)) // np.maximum(self._counts, 1)
        before = np.concatenate([[0], row[:-1]])
        return np.where(self._counts > 0, means, before).astype(np.int16)


def pack_arrays(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> str:
    """Pack a header of values that JSON can hold, all finite, and arrays of `PACKED_TYPES`.

    The text has letters, digits, `+`, `/` and `=`, and is the same for the same arguments.
    """
    listed, parts = [], []
    for name, array in arrays.items():
        kind = next(k for k, dtype in PACKED_TYPES.items() if array.dtype == np.dtype(dtype))
        listed.append({"name": name, "type": kind, "shape": list(array.shape)})
        little = np.ascontiguousarray(array, PACKED_TYPES[kind])
        parts.append(little.reshape(-1, 1).view(np.uint8).T.tobytes())
    text = json.dumps({**header, "arrays": listed}, allow_nan=False, separators=(",", ":"))
    encoded = text.encode()
    content = b"".join([struct.pack("<I", len(encoded)), encoded, *parts])
    # As gzip, without a time and a system: the same bytes everywhere.
    head = bytes([0x1F, 0x8B, 8, 0, 0, 0, 0, 0, 0, 0xFF])
    # Differences are small numbers without repeated texts: this strategy is made for them. A higher
    # level looks for such texts: level 9 takes nine times as long, for 1 % less.
    packer = zlib.compressobj(5, zlib.DEFLATED, -zlib.MAX_WBITS, strategy=zlib.Z_FILTERED)
    packed = packer.compress(content) + packer.flush()
    end = struct.pack("<II", zlib.crc32(content), len(content) & 0xFFFFFFFF)
    return base64.b64encode(head + packed + end).decode()
