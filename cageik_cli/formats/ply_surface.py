"""UVs, normals and colours of PLY: of vertices, or of the corners of faces."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.normals import compute_corner_normals, has_vertex_normals
from cageik_cli.geometry.surface_attributes import SurfaceAttributes, number_normal_fans
from cageik_cli.geometry.surface_parts import NONE, UvMap
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError

UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
NORMAL_NAMES = ("nx", "ny", "nz")
COLOUR_NAMES = ("red", "green", "blue")
CORNER_UVS = "texcoord"
"""The list of a face with the two texture coordinates of each corner, as MeshLab writes it."""

FULL = 255
"""The number of a full colour in a byte."""

MAX_BYTE = 255
"""Corners of a face that a list with a count of one byte holds."""

Columns = Mapping[str, NDArray[Any]]


def complete_surface(
    mesh: FileMesh, columns: Columns, corner_uvs: tuple[NDArray[Any], Integers] | None
) -> FileMesh:
    """Return a mesh that was parsed with what its file says of the surface.

    What does not fit is left out with a note.

    Parameters
    ----------
    columns : mapping
        The numbers of the vertices by the names of their properties, (n,) each.
    corner_uvs : tuple, optional
        The numbers of the lists `texcoord` one after the other, and the length of each.
    """
    attributes = SurfaceAttributes(mesh.corner_counts, mesh.corners)
    left_out: list[str] = []
    steps: tuple[tuple[str, Callable[[SurfaceAttributes, Columns], SurfaceAttributes]], ...] = (
        ("texture coordinates", partial(_read_uvs, corner_uvs=corner_uvs)),
        ("normals", _read_normals),
        ("colours", _read_colours),
    )
    for noun, read in steps:
        try:
            attributes = read(attributes, columns)
        except FormatError as error:
            left_out.append(f"its {noun} left out ({error})")
    return replace(mesh, attributes=attributes, left_out=tuple(left_out))


def _read_uvs(
    attributes: SurfaceAttributes,
    columns: Columns,
    corner_uvs: tuple[NDArray[Any], Integers] | None,
) -> SurfaceAttributes:
    if corner_uvs is not None and corner_uvs[1].any():
        values, sizes = corner_uvs
        if len(sizes) != len(attributes.corner_counts):
            raise FormatError(f"{len(sizes)} lists for {len(attributes.corner_counts)} faces")
        given = sizes > 0
        if (sizes != np.where(given, 2 * attributes.corner_counts, 0)).any():
            raise FormatError("a face needs two numbers per corner")
        table, numbers = np.unique(values.reshape(-1, 2), axis=0, return_inverse=True)
        indices = np.full(len(attributes.corners), NONE)
        indices[np.repeat(given, attributes.corner_counts)] = numbers.ravel()
        return replace(attributes, uvs=UvMap(table, indices))
    names = next((names for names in UV_NAMES if set(names) <= set(columns)), None)
    if names is None:
        return attributes
    return replace(attributes, uvs=UvMap(_stack(columns, names), attributes.corners))


def _read_normals(attributes: SurfaceAttributes, columns: Columns) -> SurfaceAttributes:
    if not set(NORMAL_NAMES) <= set(columns):
        return attributes
    fans = number_normal_fans(attributes.corners, attributes.corners)
    return replace(attributes, normal_fans=fans)


def _read_colours(attributes: SurfaceAttributes, columns: Columns) -> SurfaceAttributes:
    if not set(COLOUR_NAMES) <= set(columns):
        return attributes
    names = (*COLOUR_NAMES, "alpha") if "alpha" in columns else COLOUR_NAMES
    full = FULL if columns[names[0]].dtype.kind in "iu" else 1
    return replace(attributes, colours=_stack(columns, names) / full)


def _stack(columns: Columns, names: tuple[str, ...]) -> Floats:
    with np.errstate(over="ignore", invalid="ignore"):
        return np.stack([columns[name].ravel() for name in names], axis=1).astype(np.float64)


class PlySurface:
    """The bytes of frames of a mesh: positions, and all that PLY holds of its surface.

    Normals are of vertices, those of the faces around where corners have several.
    """

    def __init__(self, mesh: TriMesh) -> None:
        attributes = self._attributes = mesh.attributes
        vertex: list[tuple[str, str]] = [(axis, "<f8") for axis in "xyz"]
        self._shaded = attributes is not None and attributes.normal_fans is not None
        if self._shaded:
            vertex += [(name, "<f4") for name in NORMAL_NAMES]
        colours = None if attributes is None else attributes.colours
        if colours is not None:
            names = (*COLOUR_NAMES, "alpha")[: colours.shape[1]]
            vertex += [(name, "u1") for name in names]
        self._rows = np.zeros(len(mesh.vertices), vertex)
        if colours is not None:
            for name, column in zip(names, colours.T, strict=True):
                self._rows[name] = np.rint(np.clip(column, 0, 1) * FULL)
        self._faces = _encode_faces(mesh)
        self._head = _make_header(self._rows, mesh).encode()

    def encode_frame(self, positions: Floats) -> bytes:
        """Return the file of a frame, (m, 3)."""
        rows = self._rows.copy()
        for axis, column in zip("xyz", positions.T, strict=True):
            rows[axis] = column
        if self._shaded and self._attributes is not None:
            for name, column in zip(NORMAL_NAMES, self._average(positions).T, strict=True):
                rows[name] = column
        return self._head + rows.tobytes() + self._faces

    def _average(self, positions: Floats) -> Floats:
        """Return one normal per vertex."""
        attributes = self._attributes
        assert attributes is not None
        normals = compute_corner_normals(attributes, positions)
        if has_vertex_normals(attributes):
            found = np.zeros(positions.shape)
            found[attributes.corners] = normals
            return found
        sums = [np.bincount(attributes.corners, column, len(positions)) for column in normals.T]
        means = np.stack(sums, axis=1)
        lengths = np.linalg.norm(means, axis=1, keepdims=True)
        unit = np.divide(means, lengths, out=np.zeros_like(means), where=lengths > 0)
        return np.asarray(unit)


def _encode_faces(mesh: TriMesh) -> bytes:
    """Return the lists of the faces: vertices, and two texture coordinates per corner."""
    attributes = mesh.attributes
    if attributes is None:
        rows = np.empty(len(mesh.faces), [("corners", "u1"), ("vertices", "<i4", 3)])
        rows["corners"], rows["vertices"] = 3, mesh.faces
        return rows.tobytes()
    count_type = "<i4" if attributes.corner_counts.max() > MAX_BYTE // 2 else "u1"
    uvs = None if attributes.uvs is None else _list_corner_uvs(attributes.uvs)
    parts = []
    bounds = zip(attributes.starts.tolist(), attributes.corner_counts.tolist(), strict=True)
    corners = attributes.corners.astype("<i4")
    for start, count in bounds:
        parts += [np.array(count, count_type).tobytes(), corners[start : start + count].tobytes()]
        if uvs is not None:
            pairs = uvs[start : start + count]
            is_given = not np.isnan(pairs).any()
            parts.append(np.array(2 * count * is_given, count_type).tobytes())
            parts.append(pairs.tobytes() if is_given else b"")
    return b"".join(parts)


def _list_corner_uvs(uvs: UvMap) -> NDArray[np.float32]:
    """Return the texture coordinates of all corners, (c, 2); nan for those without."""
    table = np.concatenate([uvs.values, np.full((1, 2), np.nan)])  # `NONE` is the last
    return table[uvs.indices].astype("<f4")


def _make_header(rows: NDArray[Any], mesh: TriMesh) -> str:
    """Return the header of a binary file whose vertices are such rows."""
    words = {"<f8": "double", "<f4": "float", "|u1": "uchar"}
    attributes = mesh.attributes
    counts = None if attributes is None else attributes.corner_counts
    count_word = "uchar" if counts is None or counts.max() <= MAX_BYTE // 2 else "int"
    has_uvs = attributes is not None and attributes.uvs is not None
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    for name in rows.dtype.names or ():
        lines.append(f"property {words[rows.dtype[name].str]} {name}")
    lines.append(f"element face {len(mesh.faces) if counts is None else len(counts)}")
    lines.append(f"property list {count_word} int vertex_indices")
    lines += [f"property list {count_word} float {CORNER_UVS}"] * has_uvs
    return "\n".join([*lines, "end_header", ""])
