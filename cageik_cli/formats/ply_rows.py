"""The header of a PLY file, and the rows of its elements, binary or as text."""

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError

MAX_PLY_HEADER_BYTES = 1 << 20
"""A longer header is none."""

NORMAL_NAMES = ("nx", "ny", "nz")

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


@contextmanager
def wrap_ply_errors() -> Iterator[None]:
    """Turn what a damaged file makes of the code below into a FormatError."""
    try:
        yield
    except (ValueError, IndexError, KeyError, OverflowError, struct.error) as error:
        raise FormatError(f"is not a sound PLY mesh ({error}); export it again") from error


class PlyRows:
    """The elements of a PLY file, whose rows are read element by element, in their order.

    A damaged file raises one of the errors of `wrap_ply_errors`.

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
                self._read_header_line(line.split())
            except IndexError as error:
                raise ValueError(f"its header has the incomplete line `{line}`") from error
        self._data, self._offset = data, self.head_size
        lines = data[self.head_size :].splitlines() if self.is_text else []
        self._lines = [line for line in lines if line.strip()]

    def _read_header_line(self, words: list[str]) -> None:
        if words[:1] == ["format"]:
            orders = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
            self.order, self.is_text = _look_up(orders, words[1]), words[1] == "ascii"
        elif words[:1] == ["element"]:
            self.elements.append(Element(words[1], int(words[2]), {}))
            if self.elements[-1].count < 0:
                raise ValueError(f"its header says `{' '.join(words)}`, which is not a valid count")
        elif words[:1] == ["property"]:
            types = words[2:4] if words[1] == "list" else words[1:2]
            codes = "".join(_look_up(_TYPE_CODES, kind) for kind in types)
            known = self.elements[-1].type_codes
            if words[-1] in known or (len(codes) == 2 and codes[0] in "efd"):
                raise ValueError(f"its header has the invalid line `{' '.join(words)}`")
            known[words[-1]] = codes

    @property
    def line_count(self) -> int:
        """How many rows of a text are not read yet."""
        return len(self._lines)

    def read_rows(self, element: Element) -> NDArray[Any]:
        """Read the rows of an element without lists, (count,), in the types of the header."""
        kind = element.make_row_dtype(self.order)
        if self.is_text:
            lines = self._take_lines(element.count)
            if not lines:
                return np.empty(0, kind)
            try:
                return np.loadtxt(lines, kind, comments=None, ndmin=1)
            except ValueError as error:
                _check_lengths(element, lines)
                raise ValueError(str(error).rstrip(".")) from error
        rows = np.frombuffer(self._data, kind, element.count, self._offset)
        self._offset += rows.nbytes
        return rows

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
            words, place = line.split(), 0
            for name, codes in element.type_codes.items():
                if place >= len(words):
                    raise ValueError(f"a row of `{element.name}` has {len(words)} numbers, too few")
                size = int(words[place]) if len(codes) == 2 else 1
                place += len(codes) - 1
                if not 0 <= size <= len(words) - place:
                    raise ValueError(f"it has a list of {size} items")
                if name == wanted:
                    items += words[place : place + size]
                    sizes.append(size)
                place += size
        code = element.type_codes[wanted][1]
        with np.errstate(over="ignore"):  # what is too large for its type is refused as infinite
            numbers = np.array(list(map(float if code in "efd" else int, items)), self.order + code)
        return numbers, np.array(sizes, np.int64)

    def _read_even_rows(self, element: Element) -> NDArray[Any] | None:
        """Read the rows if the lists of all have the sizes of those in the first, else None."""
        if not element.count:
            return None
        start = self._offset
        sizes = {}
        for name in element.lists:
            self._offset = start
            sizes[name] = int(self._walk_rows(element, name, 1)[1][0])
        self._offset = start
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


def _check_lengths(element: Element, lines: list[bytes]) -> None:
    """Refuse rows of a text that have more or fewer numbers than the header says."""
    expected = len(element.type_codes)
    for number, line in enumerate(lines):
        count = len(line.split())
        if count != expected:
            raise ValueError(
                f"row {number} of `{element.name}` has {count} numbers, expected {expected}"
            )


def _look_up(known: dict[str, str], word: str) -> str:
    if word not in known:
        raise ValueError(f"its header has the unknown word `{word}`")
    return known[word]


def stack_positions(rows: NDArray[Any]) -> Floats:
    """Return the positions of rows, (n, 3)."""
    with np.errstate(invalid="ignore"):  # a signalling NaN is refused with the others
        return np.stack([rows[axis] for axis in "xyz"], axis=1, dtype=np.float64)
