"""PLY: positions and polygons, in the file's order; polygons may be of several sizes.

UVs, normals and colours are of vertices, or of the corners of faces. Rows are binary or text.
"""

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.files import with_gzip
from cageik_cli.formats.base.mesh_data import FileMesh, list_layer_readers
from cageik_cli.formats.base.readers import FrameFileReader
from cageik_cli.formats.base.writers import Animation, FrameFileWriter
from cageik_cli.geometry.attributes import LAYERS, NONE, SurfaceAttributes
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import compute_corner_normals, has_vertex_normals
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError
from cageik_cli.util.text import group_digits, single_line

NORMAL_NAMES = ("nx", "ny", "nz")

COLUMNS = {
    "uvs": (("s", "t"), ("u", "v"), ("texture_u", "texture_v")),
    "normal_fans": (NORMAL_NAMES,),
    "colours": (("red", "green", "blue", "alpha"), ("red", "green", "blue")),
}
"""The properties of vertices that hold a layer: the first that are all there. The first are
written."""

STRIPS = "tristrips"
"""The element whose lists are strips of triangles, as of scans; -1 begins a new one."""

FACE_ELEMENTS = ("face", STRIPS)

CORNER_UVS = "texcoord"
"""The list of a face with the two texture coordinates of each corner, as MeshLab writes it."""

CornerUvs = tuple[NDArray[Any], Integers]
"""The numbers of the lists `texcoord` one after the other, and the length of each."""

MAX_PLY_HEADER_BYTES = 1 << 20
"""A longer header is none."""

_TYPE_CODES = {
    **dict.fromkeys(("char", "int8"), "b"),
    **dict.fromkeys(("uchar", "uint8"), "B"),
    **dict.fromkeys(("short", "int16"), "h"),
    **dict.fromkeys(("ushort", "uint16"), "H"),
    **dict.fromkeys(("int", "int32"), "i"),
    **dict.fromkeys(("uint", "uint32"), "I"),
    "int64": "q",
    "uint64": "Q",
    "float16": "e",
    **dict.fromkeys(("float", "float32"), "f"),
    **dict.fromkeys(("double", "float64"), "d"),
}
"""The letters of types for `struct` and numpy; a list has two, of its count and of its items."""


class Reader(FrameFileReader):
    """Frames from PLY files."""

    suffixes = with_gzip(".ply")

    @classmethod
    def parse(cls, data: bytes) -> FileMesh:
        """Parse the content of a PLY file."""
        vertices, corners, sizes = None, [np.empty(0, np.int64)], [np.empty(0, np.int64)]
        with _wrap_ply_errors():
            file = PlyRows(data)
            waiting = {element.name for element in file.elements} & {"vertex", *FACE_ELEMENTS}
            for element in file.elements:
                if element.name in FACE_ELEMENTS:
                    found, counts = file.read_list(element, _find_corner_list(element))
                    if element.name == STRIPS:
                        found, counts = cut_strips(found, counts)
                    corners.append(found.astype(np.int64))
                    sizes.append(counts)
                elif element.name == "vertex":
                    vertices = stack_positions(file.read_rows(element))
                elif waiting:
                    file.skip(element)
                waiting.discard(element.name)
            if vertices is None:
                raise ValueError("it has no vertices")
        return FileMesh(vertices, np.concatenate(corners), np.concatenate(sizes))

    @classmethod
    def make_frame_parser(
        cls, data: bytes, mesh: FileMesh
    ) -> Callable[[bytes], Floats | None] | None:
        """Return a parser of frames that differ from the first in their vertices alone."""
        return PlyFrameParser(data).parse_positions

    @classmethod
    def read_attributes(cls, data: bytes, mesh: FileMesh) -> FileMesh:
        """Read UVs, normals and colours."""
        try:
            with _wrap_ply_errors():
                columns, corner_uvs = _read_surface_columns(data)
        except FormatError as error:
            note = f"its colours, normals and texture coordinates are left out ({error.__cause__})"
            return replace(mesh, left_out=(note,))
        read = partial(_read_layer, columns, corner_uvs)
        return mesh.read_layers(list_layer_readers(COLUMNS, read))


class PlyFrameParser:
    """Reads binary PLY frames that differ from a first frame in the vertices alone."""

    def __init__(self, first: bytes) -> None:
        self._head, self._tail, self._size = b"", b"", len(first)
        file = PlyRows(first)
        vertex = file.elements[0]
        if not file.is_text and vertex.name == "vertex" and not vertex.lists:
            self._kind, self._count = vertex.make_row_dtype(file.order), vertex.count
            self._head = first[: file.head_size]
            self._tail = first[file.head_size + self._kind.itemsize * self._count :]

    def parse_positions(self, data: bytes) -> Floats | None:
        """Return the vertices (m, 3) if all other bytes are the first frame's, else None."""
        if not self._head or len(data) != self._size:
            return None
        if not data.startswith(self._head) or not data.endswith(self._tail):
            return None
        return stack_positions(np.frombuffer(data, self._kind, self._count, len(self._head)))


@dataclass(frozen=True, slots=True)
class Element:
    """An element of a header, such as vertices or faces: count, and type codes by property."""

    name: str
    count: int
    type_codes: dict[str, str]

    @property
    def lists(self) -> list[str]:
        """The properties that are lists, so that rows may differ in size."""
        return [name for name, codes in self.type_codes.items() if len(codes) == 2]

    def make_row_dtype(self, order: str, sizes: dict[str, int] | None = None) -> np.dtype[Any]:
        """Return the type of a row whose lists have these sizes; a count is the field `NAME#`."""
        fields: list[Any] = []
        for name, codes in self.type_codes.items():
            if len(codes) == 2:
                fields.append((f"{name}#", order + codes[0]))
                fields.append((name, order + codes[1], ((sizes or {})[name],)))
            else:
                fields.append((name, order + codes))
        return np.dtype(fields)


def _find_corner_list(face: Element) -> str:
    """Return the list of the faces that names their vertices."""
    names = face.lists
    if not names:
        raise ValueError("its faces have no list of vertices")
    found = next((name for name in ("vertex_indices", "vertex_index") if name in names), names[0])
    if face.type_codes[found][1] in "efd":
        raise ValueError("its faces name vertices by numbers that are not whole")
    return found


def cut_strips(numbers: NDArray[Any], sizes: Integers) -> tuple[Integers, Integers]:
    """Return the corners of the triangles of strips, (3 t,), and the sizes of these.

    Every second triangle of a strip is turned. Triangles with two equal corners, by which strips
    are joined, are left out.

    Parameters
    ----------
    numbers : (k,)
        The strips, one list after the other; -1, or the largest number of an unsigned type, ends
        one.
    sizes : (s,)
        How many numbers each list has.
    """
    ends = np.cumsum(sizes)
    if numbers.dtype.kind == "u":
        is_end = numbers == np.iinfo(numbers.dtype).max
        numbers = np.where(is_end, NONE, numbers.astype(np.int64))
    row = np.insert(numbers.astype(np.int64), ends, NONE)
    places = np.arange(len(row))
    starts = np.maximum.accumulate(np.where(row == NONE, places + 1, 0))
    triples = np.stack([row[:-2], row[1:-1], row[2:]], axis=1) if len(row) > 2 else row[:0, None]
    triples = triples.reshape(-1, 3)
    is_odd = (places[: len(triples)] - starts[: len(triples)]) % 2 == 1
    triples[is_odd] = triples[is_odd][:, [1, 0, 2]]
    is_whole = (triples != NONE).all(axis=1)
    is_whole &= (triples != np.roll(triples, 1, axis=1)).all(axis=1)
    corners = triples[is_whole]
    return corners.ravel(), np.full(len(corners), 3, np.int64)


def _read_surface_columns(data: bytes) -> tuple[dict[str, NDArray[Any]], CornerUvs | None]:
    """Read the properties of vertices, (n,) each, and the UVs of the corners of faces."""
    file, columns = PlyRows(data), dict[str, NDArray[Any]]()
    for element in file.elements:
        if element.name == "vertex":
            rows = file.read_rows(element)
            columns = {name: rows[name] for name in rows.dtype.names or ()}
        elif element.name == "face":
            code = element.type_codes.get(CORNER_UVS, "")
            has_uvs = len(code) == 2 and code[1] in "efd"
            return columns, file.read_list(element, CORNER_UVS) if has_uvs else None
        else:
            file.skip(element)
    return columns, None


def _read_layer(
    columns: dict[str, NDArray[Any]],
    corner_uvs: CornerUvs | None,
    name: str,
    attributes: SurfaceAttributes,
) -> SurfaceAttributes:
    """Read a layer from its properties; UVs of corners come before those of vertices."""
    if name == "uvs" and corner_uvs is not None and corner_uvs[1].any():
        values, sizes = corner_uvs
        if len(sizes) != len(attributes.corner_counts):
            raise FormatError(
                f"{len(sizes)} lists for {group_digits(len(attributes.corner_counts))} faces"
            )
        given = sizes > 0
        if (sizes != np.where(given, 2 * attributes.corner_counts, 0)).any():
            raise FormatError("a face needs two numbers per corner")
        table, numbers = np.unique(values.reshape(-1, 2), axis=0, return_inverse=True)
        indices = np.full(len(attributes.corners), NONE)
        indices[np.repeat(given, attributes.corner_counts)] = numbers.ravel()
        return attributes.add_layer(name, table, indices)
    names = next((names for names in COLUMNS[name] if set(names) <= set(columns)), None)
    if names is None:
        return attributes
    with np.errstate(over="ignore", invalid="ignore"):
        rows = np.stack([columns[name] for name in names], axis=1).astype(np.float64)
    if LAYERS[name].domain == "vertex" and columns[names[0]].dtype.kind in "iu":
        rows /= 255
    return attributes.add_layer(name, rows, attributes.corners)


class Writer(FrameFileWriter):
    """Writes binary, little-endian files in double precision: every digit is kept.

    Normals are of vertices, those of the faces around where corners have several.
    """

    suffixes = (".ply",)

    def __init__(self, target: Path, animation: Animation) -> None:
        super().__init__(target, animation)
        self._shaded = animation.rest.shaded
        self._rows = _make_rows(animation.rest)
        head, self._faces = _encode_faces(animation.rest)
        lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(self._rows)}"]
        for name in self._rows.dtype.names or ():
            word = {8: "double", 4: "float", 1: "uchar"}[self._rows.dtype[name].itemsize]
            lines.append(f"property {word} {name}")
        self._head = "\n".join([*lines, *head, "end_header", ""]).encode()

    def encode_frame(self, positions: Floats) -> bytes:
        """Return the bytes of one frame."""
        rows = self._rows.copy()
        for axis, column in zip("xyz", positions.T, strict=True):
            rows[axis] = column
        if self._shaded is not None:
            normals = _average_normals(self._shaded, positions)
            for name, column in zip(NORMAL_NAMES, normals.T, strict=True):
                rows[name] = column
        return self._head + rows.tobytes() + self._faces


def _make_rows(mesh: TriMesh) -> NDArray[Any]:
    """Return the rows of the vertices, (n,), with their colours and nothing else yet."""
    kinds = [(axis, "<f8") for axis in "xyz"]
    kinds += [(name, "<f4") for name in NORMAL_NAMES if mesh.shaded]
    colours = mesh.polygons.colours
    names = COLUMNS["colours"][0][: 0 if colours is None else colours.shape[1]]
    rows = np.zeros(len(mesh.vertices), [*kinds, *((name, "u1") for name in names)])
    if colours is not None:
        for name, column in zip(names, colours.T, strict=True):
            rows[name] = np.rint(np.clip(column, 0, 1) * 255)
    return rows


def _average_normals(attributes: SurfaceAttributes, positions: Floats) -> Floats:
    """Return one normal per vertex, (n, 3)."""
    normals = compute_corner_normals(attributes, positions)
    if has_vertex_normals(attributes):
        found = np.zeros(positions.shape)
        found[attributes.corners] = normals
        return found
    sums = [np.bincount(attributes.corners, column, len(positions)) for column in normals.T]
    means = np.stack(sums, axis=1)
    lengths = np.linalg.norm(means, axis=1, keepdims=True)
    return np.asarray(np.divide(means, lengths, out=np.zeros_like(means), where=lengths > 0))


def _encode_faces(mesh: TriMesh) -> tuple[list[str], bytes]:
    """Return the lines of the header, and the lists: vertices, and UVs of each corner."""
    attributes = mesh.attributes
    if attributes is None:
        rows = np.empty(len(mesh.faces), [("corners", "u1"), ("vertices", "<i4", 3)])
        rows["corners"], rows["vertices"] = 3, mesh.faces
        lines = [f"element face {len(rows)}", "property list uchar int vertex_indices"]
        return lines, rows.tobytes()
    counts = attributes.corner_counts
    is_small = 2 * counts.max() <= np.iinfo(np.uint8).max  # two numbers per corner in a list
    word, count_type = ("uchar", "u1") if is_small else ("int", "<i4")
    lines = [f"element face {len(counts)}", f"property list {word} int vertex_indices"]
    uvs = None
    if attributes.uvs is not None:
        lines.append(f"property list {word} float {CORNER_UVS}")
        table, indices = attributes.uvs.complete(np.nan)
        uvs = table[indices].astype("<f4")
    parts, corners = [], attributes.corners.astype("<i4")
    for start, count in zip(attributes.starts.tolist(), counts.tolist(), strict=True):
        parts += [np.array(count, count_type).tobytes(), corners[start : start + count].tobytes()]
        if uvs is not None:
            pairs = uvs[start : start + count]
            is_given = not np.isnan(pairs).any()
            parts.append(np.array(2 * count * is_given, count_type).tobytes())
            parts.append(pairs.tobytes() if is_given else b"")
    return lines, b"".join(parts)


@contextmanager
def _wrap_ply_errors() -> Iterator[None]:
    """Turn what a damaged file makes of the code below into a FormatError."""
    try:
        yield
    except (ValueError, IndexError, KeyError, OverflowError, struct.error) as error:
        cause = str(error)
        if isinstance(error, struct.error):
            cause = "it is cut short"
        elif isinstance(error, OverflowError):
            cause = "a number is too large or small for its type"
        raise FormatError(f"is not a sound PLY mesh ({cause}); export it again") from error


class PlyRows:
    """The elements of a PLY file, whose rows are read element by element, in their order.

    A damaged file raises one of the errors of `_wrap_ply_errors`.

    Attributes
    ----------
    head_size : int
        Bytes of the header.
    order : str
        The byte order, "<" or ">"; that of the rows of a text is "<".
    """

    def __init__(self, data: bytes) -> None:
        mark = data.find(b"end_header", 0, MAX_PLY_HEADER_BYTES)
        self.head_size = data.find(b"\n", mark) + 1
        if not data.startswith(b"ply") or mark < 0 or not self.head_size:
            raise ValueError("it has no PLY header")
        self.is_text, self.order, self.elements = False, "", list[Element]()
        for line in data[: self.head_size].decode("utf-8", "replace").splitlines():
            try:
                words = line.split()
                if words[:1] == ["format"]:
                    orders = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
                    self.order, self.is_text = _look_up(orders, words[1]), words[1] == "ascii"
                elif words[:1] == ["element"]:
                    self.elements.append(Element(words[1], _to_integer(words[2]), {}))
                    if self.elements[-1].count < 0:
                        raise ValueError(
                            f"its header says `{' '.join(words)}`, which is not a valid count"
                        )
                elif words[:1] == ["property"]:
                    types = words[2:4] if words[1] == "list" else words[1:2]
                    codes = "".join(_look_up(_TYPE_CODES, kind) for kind in types)
                    known = self.elements[-1].type_codes
                    is_whole = len(codes) == 1 + (words[1] == "list")
                    if words[-1] in known or not is_whole or codes[:-1] in {"e", "f", "d"}:
                        raise ValueError(f"its header has the invalid line `{' '.join(words)}`")
                    known[words[-1]] = codes
            except IndexError as error:
                raise ValueError(f"its header has the incomplete line `{line}`") from error
        self._data, self._offset = data, self.head_size
        lines = data[self.head_size :].splitlines() if self.is_text else []
        self._lines = [line for line in lines if line.strip()]

    @property
    def line_count(self) -> int:
        """How many rows of a text are not read yet."""
        return len(self._lines)

    def read_rows(self, element: Element) -> NDArray[Any]:
        """Read the rows of an element, (count,), in the types of the header, without lists."""
        if element.lists:
            return self._read_beside_lists(element)
        kind = element.make_row_dtype(self.order)
        if self.is_text:
            lines = self._take_lines(element.count)
            if not lines:
                return np.empty(0, kind)
            try:
                return np.loadtxt(lines, kind, comments=None, ndmin=1)
            except ValueError as error:
                _check_rows(element, lines)
                raise ValueError(f"a row of `{element.name}` has other numbers") from error
        if self._offset + element.count * kind.itemsize > len(self._data):
            raise ValueError("it is cut short")
        rows = np.frombuffer(self._data, kind, element.count, self._offset)
        self._offset += rows.nbytes
        return rows

    def _read_beside_lists(self, element: Element) -> NDArray[Any]:
        """Read what is no list of rows whose lists may differ in size."""
        if element.count > len(self._data):  # a row has a byte, at least
            raise ValueError("it is cut short")
        codes = {name: code for name, code in element.type_codes.items() if len(code) == 1}
        found = np.empty(element.count, [(name, self.order + code) for name, code in codes.items()])
        even = None if self.is_text else self._read_even_rows(element)
        if even is not None:
            for name in codes:
                found[name] = even[name]
            return found
        walk = self._walk_text_rows if self.is_text else self._walk_scalars
        columns: dict[str, list[float]] = {name: [] for name in codes}
        for name, value in walk(element):
            columns[name].append(value)
        with np.errstate(over="ignore"):  # what is too large for its type is refused as infinite
            for name, values in columns.items():
                found[name] = values
        return found

    def _walk_text_rows(self, element: Element) -> Iterator[tuple[str, float]]:
        """Yield the names and values of what is no list, row by row of a text."""
        for line in self._take_lines(element.count):
            for name, words in _cut_text_row(element, line):
                if len(element.type_codes[name]) == 1:
                    yield name, _to_float(words[0])

    def _walk_scalars(self, element: Element) -> Iterator[tuple[str, float]]:
        """Yield the names and values of what is no list, row by row."""
        steps = [
            (name, struct.Struct(self.order + codes[0]), struct.calcsize(self.order + codes[1:]))
            for name, codes in element.type_codes.items()
        ]
        for _ in range(element.count):
            for name, first, width in steps:
                (value,) = first.unpack_from(self._data, self._offset)
                self._offset += first.size
                if not width:
                    yield name, value
                elif value < 0 or self._offset + value * width > len(self._data):
                    raise ValueError(f"it has a list of {value} items")
                else:
                    self._offset += value * width

    def read_list(self, element: Element, wanted: str) -> tuple[NDArray[Any], Integers]:
        """Read one list of every row: the items one row after the other, and how many each has."""
        if self.is_text:
            return self._read_text_list(element, wanted)
        rows = self._read_even_rows(element)
        if rows is not None:
            return rows[wanted].ravel(), rows[f"{wanted}#"].astype(np.int64)
        items, sizes = self._walk_rows(element, wanted, element.count)
        return np.frombuffer(items, self.order + element.type_codes[wanted][1]), sizes

    def skip(self, element: Element) -> None:
        """Pass over the rows of an element."""
        if self.is_text:
            self._take_lines(element.count)
        elif element.type_codes:
            self._walk_rows(element, "", element.count)

    def _take_lines(self, count: int) -> list[bytes]:
        if count > len(self._lines):
            raise ValueError("it is cut short")
        lines, self._lines = self._lines[:count], self._lines[count:]
        return lines

    def _read_text_list(self, element: Element, wanted: str) -> tuple[NDArray[Any], Integers]:
        items: list[bytes] = []
        sizes = []
        for line in self._take_lines(element.count):
            for name, words in _cut_text_row(element, line):
                if name == wanted:
                    items += words
                    sizes.append(len(words))
        code = element.type_codes[wanted][1]
        convert = _to_float if code in "efd" else _to_integer
        found = list(map(convert, items))
        try:
            with np.errstate(over="ignore"):  # what is too large for floats is refused as infinite
                numbers = np.array(found, self.order + code)
        except OverflowError:
            _check_fit(items, code)
            raise
        return numbers, np.array(sizes, np.int64)

    def _read_even_rows(self, element: Element) -> NDArray[Any] | None:
        """Read the rows if the lists of all have the sizes of those in the first, else None."""
        if not element.count:
            return None
        start = offset = self._offset
        sizes = {}
        for name, codes in element.type_codes.items():
            (size,) = struct.unpack_from(self.order + codes[0], self._data, offset)
            offset += struct.calcsize(self.order + codes[0])
            if len(codes) == 2:
                if size < 0:
                    raise ValueError(f"it has a list of {size} items")
                sizes[name] = int(size)
                offset += size * struct.calcsize(self.order + codes[1])
        if offset > len(self._data):
            raise ValueError("it is cut short")
        kind = element.make_row_dtype(self.order, sizes)
        if start + element.count * kind.itemsize > len(self._data):
            return None
        rows = np.frombuffer(self._data, kind, element.count, start)
        if not all((rows[f"{name}#"] == size).all() for name, size in sizes.items()):
            return None
        self._offset += rows.nbytes
        return rows

    def _walk_rows(self, element: Element, wanted: str, count: int) -> tuple[bytes, Integers]:
        """Read the items of a list in the next `count` rows, and how many each row has."""
        data, offset = self._data, self._offset
        steps = [
            (
                name == wanted,
                struct.Struct(self.order + codes[0]),
                struct.calcsize(self.order + codes[1:]),
            )
            for name, codes in element.type_codes.items()
        ]
        items, sizes = [], []
        for _ in range(count):
            for is_wanted, first, width in steps:
                (size,) = first.unpack_from(data, offset)
                offset += first.size
                if width and size < 0:
                    raise ValueError(f"it has a list of {size} items")
                if is_wanted:
                    items.append(data[offset : offset + size * width])
                    sizes.append(size)
                offset += size * width if width else 0
        if offset > len(data):
            raise ValueError("it is cut short")
        self._offset = offset
        return b"".join(items), np.array(sizes, np.int64)


def _cut_text_row(element: Element, line: bytes) -> Iterator[tuple[str, list[bytes]]]:
    """Yield the name of each property of a row of a text, and its numbers."""
    words, place = line.split(), 0
    for name, codes in element.type_codes.items():
        if place >= len(words):
            raise ValueError(f"a row of `{element.name}` has {len(words)} numbers, too few")
        size = _to_integer(words[place]) if len(codes) == 2 else 1
        place += len(codes) - 1
        if not 0 <= size <= len(words) - place:
            raise ValueError(f"it has a list of {size} items")
        yield name, words[place : place + size]
        place += size


def _check_rows(element: Element, lines: list[bytes]) -> None:
    """Refuse rows of a text that have more or fewer numbers than the header says, or other ones."""
    codes = element.type_codes.values()
    for number, line in enumerate(lines):
        words = line.split()
        if len(words) != len(codes):
            raise ValueError(
                f"row {number} of `{element.name}` has {len(words)} numbers, expected {len(codes)}"
            )
        for word, code in zip(words, codes, strict=True):
            if code in "efd":
                _to_float(word)
            else:
                _check_fit([word], code)


def _check_fit(words: list[bytes], code: str) -> None:
    """Refuse the first whole number that its type does not hold."""
    limits = np.iinfo(code)
    for word in words:
        if not limits.min <= _to_integer(word) <= limits.max:
            raise ValueError(f"{_quote(word)} is too large or small for its type")


def _to_integer(word: bytes | str) -> int:
    try:
        return int(word)
    except ValueError:
        raise ValueError(f"{_quote(word)} is not a whole number") from None


def _to_float(word: bytes) -> float:
    try:
        return float(word.replace(b"_", b"?"))  # Python's digit separator is no number in a file
    except ValueError:
        raise ValueError(f"{_quote(word)} is not a number") from None


def _quote(word: bytes | str) -> str:
    text = word.decode("utf-8", "replace") if isinstance(word, bytes) else word
    return f"`{single_line(text if len(text) <= 40 else text[:37] + '...')}`"


def _look_up(known: dict[str, str], word: str) -> str:
    if word not in known:
        raise ValueError(f"its header has the unknown word `{word}`")
    return known[word]


def stack_positions(rows: NDArray[Any]) -> Floats:
    """Return the positions of rows, (n, 3)."""
    absent = [axis for axis in "xyz" if axis not in (rows.dtype.names or ())]
    if absent:
        raise ValueError(f"its vertices have no property `{absent[0]}`")
    with np.errstate(invalid="ignore"):  # a signalling NaN is refused with the others
        return np.stack([rows[axis] for axis in "xyz"], axis=1, dtype=np.float64)
