"""PLY: positions and polygons, in the file's order; polygons may be of several sizes.

Binary files are parsed here, text files by trimesh.
"""

import io
import logging
import re
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.files import with_gzip
from cageik_cli.formats.base.mesh_data import FileMesh, fan_triangulate_polygons
from cageik_cli.formats.base.readers import FrameFileReader
from cageik_cli.formats.base.writers import Animation, FrameFileWriter
from cageik_cli.formats.ply_surface import CORNER_UVS, Columns, PlySurface, complete_surface
from cageik_cli.geometry.surface_attributes import fan_triangulate
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError

_BYTE_ORDERS = {b"binary_little_endian": "<", b"binary_big_endian": ">"}

_TYPE_CODES = {
    **dict.fromkeys((b"char", b"int8"), "b"),
    **dict.fromkeys((b"uchar", b"uint8"), "B"),
    **dict.fromkeys((b"short", b"int16"), "h"),
    **dict.fromkeys((b"ushort", b"uint16"), "H"),
    **dict.fromkeys((b"int", b"int32"), "i"),
    **dict.fromkeys((b"uint", b"uint32"), "I"),
    b"int64": "q",
    b"uint64": "Q",
    b"float16": "e",
    **dict.fromkeys((b"float", b"float32"), "f"),
    **dict.fromkeys((b"double", b"float64"), "d"),
}
"""The letters of types for `struct` and numpy; a list has two, of its count and of its items."""


# Where a header announces how many vertices and faces follow.
_COUNTS = re.compile(rb"(?ms)^element vertex (\d+)\s.*?^element face (\d+)\s")


class Reader(FrameFileReader):
    """Frames from PLY files."""

    suffixes = with_gzip(".ply")

    @classmethod
    def parse(cls, data: bytes) -> FileMesh:
        """Parse the content of a PLY file."""
        if is_binary_ply(data):
            vertices, corners, sizes = parse_binary_ply(data)
            return FileMesh(vertices, fan_triangulate(corners, sizes), sizes)
        vertices, polygons = parse_ascii_ply(data)
        return FileMesh(vertices, *fan_triangulate_polygons(polygons))

    @classmethod
    def make_frame_parser(cls, data: bytes, mesh: FileMesh) -> "PlyFrameParser":
        """Return a parser of frames that differ from the first in their vertices alone."""
        return PlyFrameParser(data)

    @classmethod
    def read_attributes(cls, data: bytes, mesh: FileMesh) -> FileMesh:
        """Read UVs, normals and colours."""
        read = _read_binary_columns if is_binary_ply(data) else _read_ascii_columns
        try:
            columns, corner_uvs = read(data)
        except (ValueError, IndexError, KeyError, OverflowError, struct.error) as error:
            note = f"its colours, normals and texture coordinates are left out ({error})"
            return replace(mesh, left_out=(note,))
        return complete_surface(mesh, columns, corner_uvs)


@dataclass(frozen=True, slots=True)
class Element:
    """An element of a header, such as vertices or faces: count, and type codes by property."""

    name: bytes
    count: int
    type_codes: dict[bytes, str]


class PlyFrameParser:
    """Reads binary PLY frames that differ from a first frame in the vertices alone."""

    def __init__(self, first: bytes) -> None:
        self._head, self._tail, self._size = b"", b"", len(first)
        if is_binary_ply(first):
            order, elements, start = parse_header(first)
            if elements[0].name == b"vertex" and not has_lists(elements[0]):
                self._row_dtype, self._vertex_count = (
                    make_row_dtype(elements[0], order, {}),
                    elements[0].count,
                )
                self._head = first[:start]
                self._tail = first[start + self._row_dtype.itemsize * self._vertex_count :]

    def parse_positions(self, data: bytes) -> Floats | None:
        """Return the vertices (m, 3) if all other bytes are the first frame's, else None."""
        if not self._head or len(data) != self._size:
            return None
        if not data.startswith(self._head) or not data.endswith(self._tail):
            return None
        return stack_positions(
            np.frombuffer(data, self._row_dtype, self._vertex_count, len(self._head))
        )


def is_binary_ply(data: bytes) -> bool:
    """Return whether a file is a binary PLY, by its header."""
    words = data[:200].split(maxsplit=4)
    return words[:2] == [b"ply", b"format"] and words[2:3] != [b"ascii"]


def parse_binary_ply(data: bytes) -> tuple[Floats, Integers, Integers]:
    """Read the vertices (n, 3), the corners of all faces in order, and how many each has.

    Raises
    ------
    FormatError
        When it is not one.
    """
    try:
        order, elements, offset = parse_header(data)
        vertices, corners, sizes = None, np.empty(0, np.int64), np.empty(0, np.int64)
        for element in elements:
            if element.name == b"face":
                corners, sizes, offset = _parse_faces(data, offset, element, order)
            elif element.name == b"vertex" and not has_lists(element):
                rows = np.frombuffer(
                    data, make_row_dtype(element, order, {}), element.count, offset
                )
                vertices, offset = stack_positions(rows), offset + rows.nbytes
            elif vertices is None or not len(sizes):
                _, _, offset = _parse_list_rows(data, offset, element, order, b"")
        if vertices is None:
            raise ValueError("it has no vertices")
    except KeyError as error:
        raise FormatError(
            f"is not a sound PLY mesh (its header has the unknown word {error}); export it again"
        ) from error
    except (ValueError, IndexError, OverflowError, struct.error) as error:
        raise FormatError(f"is not a sound PLY mesh ({error}); export it again") from error
    return vertices, corners, sizes


def parse_ascii_ply(data: bytes) -> tuple[Floats, list[Integers]]:
    """Read the vertices (n, 3) and the corners of each face of a PLY text, by trimesh.

    Raises
    ------
    FormatError
        When it is not one, or is cut short.
    """
    from trimesh.exchange.ply import load_ply

    # Its loader may log a traceback of its own before it raises.
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    try:
        loaded = load_ply(io.BytesIO(data), fix_texture=False, skip_materials=True)
        # Its own triangles tell neither polygons nor their order.
        faces = loaded["metadata"]["_ply_raw"].get("face", {"length": 0})
        lists = faces["data"] if faces["length"] else {"none": []}
        name = next(name for name in ("vertex_indices", "vertex_index", *lists) if name in lists)
        vertices, polygons = np.asarray(loaded["vertices"]), list(lists[name])
    except Exception as error:  # whatever a damaged file makes trimesh raise
        raise FormatError(f"is not a sound PLY mesh ({error}); export it again") from error
    announced = _COUNTS.search(data)
    counts = (len(vertices), len(polygons))
    if announced is not None and counts != tuple(map(int, announced.groups())):
        raise FormatError(
            f"announces {int(announced[1])} vertices and {int(announced[2])} faces, holds "
            f"{counts[0]} and {counts[1]}; it is cut short, export it again"
        )
    return vertices, polygons


def _read_binary_columns(data: bytes) -> tuple[Columns, tuple[NDArray[Any], Integers] | None]:
    """Read the properties of vertices, and the texture coordinates of the corners of faces."""
    order, elements, offset = parse_header(data)
    columns: Columns = {}
    for element in elements:
        if element.name == b"vertex" and not has_lists(element):
            kind = make_row_dtype(element, order, {})
            rows = np.frombuffer(data, kind, element.count, offset)
            columns, offset = {name: rows[name] for name in kind.names or ()}, offset + rows.nbytes
        elif element.name == b"face":
            code = element.type_codes.get(CORNER_UVS.encode(), "")
            if len(code) != 2 or code[1] not in "efd":
                return columns, None
            name = CORNER_UVS.encode()
            found, sizes, _ = _parse_list_rows(data, offset, element, order, name)
            return columns, (np.frombuffer(found, order + code[1]), sizes)
        else:
            _, _, offset = _parse_list_rows(data, offset, element, order, b"")
    return columns, None


def _read_ascii_columns(data: bytes) -> tuple[Columns, tuple[NDArray[Any], Integers] | None]:
    """Read the same of a text."""
    from trimesh.exchange.ply import load_ply

    try:
        loaded = load_ply(io.BytesIO(data), fix_texture=False, skip_materials=True)
        held = loaded["metadata"]["_ply_raw"]
        columns = {name: np.asarray(column) for name, column in held["vertex"]["data"].items()}
        lists = held["face"]["data"].get(CORNER_UVS)
    except Exception as error:  # whatever a damaged file makes trimesh raise
        raise ValueError(str(error)) from error
    if lists is None:
        return columns, None
    sizes = np.array([len(row) for row in lists], np.int64)
    return columns, (np.concatenate([np.asarray(row, np.float64) for row in lists]), sizes)


def parse_header(data: bytes) -> tuple[str, list[Element], int]:
    """Return the byte order, the elements, and where they begin."""
    end = data.index(b"\n", data.index(b"end_header")) + 1
    order, elements = "", []
    for words in map(bytes.split, data[:end].splitlines()):
        if words[:1] == [b"format"]:
            order = _BYTE_ORDERS[words[1]]
        elif words[:1] == [b"element"]:
            elements.append(Element(words[1], int(words[2]), {}))
        elif words[:1] == [b"property"]:
            types = words[2:4] if words[1] == b"list" else words[1:2]
            codes = "".join(_TYPE_CODES[kind] for kind in types)
            if words[-1] in elements[-1].type_codes or (len(codes) == 2 and codes[0] in "efd"):
                raise ValueError(f"its header has the invalid line `{b' '.join(words).decode()}`")
            elements[-1].type_codes[words[-1]] = codes
    return order, elements, end


def has_lists(element: Element) -> bool:
    """Return whether rows of an element may differ in size."""
    return any(len(codes) == 2 for codes in element.type_codes.values())


def make_row_dtype(element: Element, order: str, sizes: dict[bytes, int]) -> np.dtype[Any]:
    """Return the type of a row whose lists have these sizes; a list's count is field `NAME#`."""
    fields: list[Any] = []
    for name, codes in element.type_codes.items():
        key = name.decode()
        if len(codes) == 2:
            fields.append((f"{key}#", order + codes[0]))
            fields.append((key, order + codes[1], (sizes[name],)))
        else:
            fields.append((key, order + codes))
    return np.dtype(fields)


def stack_positions(rows: NDArray[Any]) -> Floats:
    """Return the positions of rows, (n, 3)."""
    with np.errstate(invalid="ignore"):  # a signalling NaN is refused with the others
        return np.stack([rows[axis] for axis in "xyz"], axis=1, dtype=np.float64)


def _parse_faces(
    data: bytes, offset: int, element: Element, order: str
) -> tuple[Integers, Integers, int]:
    """Read the corners of the faces, how many each has, and where the next element begins."""
    lists = [name for name, codes in element.type_codes.items() if len(codes) == 2]
    if not lists:
        raise ValueError("its faces have no list of vertices")
    wanted = next((n for n in (b"vertex_indices", b"vertex_index") if n in lists), lists[0])
    code = element.type_codes[wanted][1]
    if code in "efd":
        raise ValueError("its faces name vertices by numbers that are not whole")
    if lists == [wanted] and element.count:
        _, sizes, _ = _parse_list_rows(data, offset, replace(element, count=1), order, wanted)
        kind = make_row_dtype(element, order, {wanted: int(sizes[0])})
        if offset + element.count * kind.itemsize <= len(data):
            rows = np.frombuffer(data, kind, element.count, offset)
            counts = rows[f"{wanted.decode()}#"].astype(np.int64)
            if (counts == sizes[0]).all():
                corners = rows[wanted.decode()].astype(np.int64)
                return corners.ravel(), counts, offset + rows.nbytes
    found, sizes, offset = _parse_list_rows(data, offset, element, order, wanted)
    return np.frombuffer(found, order + code).astype(np.int64), sizes, offset


def _parse_list_rows(
    data: bytes, offset: int, element: Element, order: str, wanted: bytes
) -> tuple[bytes, Integers, int]:
    """Read the items of a list in every row, their counts, and where the next element begins."""
    steps = [
        (name == wanted, struct.Struct(order + codes[0]), struct.calcsize(order + codes[1:]))
        for name, codes in element.type_codes.items()
    ]
    items, sizes = [], []
    for _ in range(element.count if steps else 0):
        for is_wanted, first, width in steps:
            (count,) = first.unpack_from(data, offset)
            offset += first.size
            if width and count < 0:
                raise ValueError(f"it has a list of {count} items")
            if is_wanted:
                items.append(data[offset : offset + count * width])
                sizes.append(count)
            offset += count * width if width else 0
    if offset > len(data):
        raise ValueError("it is cut short")
    return b"".join(items), np.array(sizes, np.int64), offset


class Writer(FrameFileWriter):
    """Writes binary, little-endian files in double precision: every digit is kept."""

    suffixes = (".ply",)

    def __init__(self, target: Path, animation: Animation) -> None:
        super().__init__(target, animation)
        self._surface = PlySurface(animation.rest)

    def encode_frame(self, positions: Floats) -> bytes:
        """Return the bytes of one frame."""
        return self._surface.encode_frame(positions)
