"""PLY files of points without faces: their positions, and all other properties as they are.

Binary files are written as they were read, byte for byte, but for the positions. A text becomes a
little-endian binary file with the same properties.
"""

import io
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.writer import Animation, FrameFileWriter
from cageik_cli.formats.ply import (
    Element,
    has_lists,
    is_binary_ply,
    make_row_dtype,
    parse_header,
    stack_positions,
)
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FormatError, OutputError

POSITION_NAMES = ("x", "y", "z")

NORMAL_NAMES = ("nx", "ny", "nz")

MOVED = np.dtype([(name, np.float64) for name in POSITION_NAMES + NORMAL_NAMES])
"""Places and normals, before they are rounded to the types of a file."""

MAX_HEADER_BYTES = 1 << 20
"""A longer header is none."""

_END = b"end_header"


@dataclass(frozen=True, slots=True, eq=False)
class PointFile:
    """The content of a PLY file of points.

    Attributes
    ----------
    head : bytes
        Its header, which says that it is binary.
    rows : (m,) structured array
        The properties of the points, in the file's types and byte order.
    tail : bytes
        What comes after the points.
    """

    head: bytes
    rows: NDArray[Any]
    tail: bytes

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the properties."""
        return self.rows.dtype.names or ()

    @property
    def positions(self) -> Floats:
        """The positions, (m, 3)."""
        return stack_positions(self.rows)

    @property
    def normals(self) -> Floats | None:
        """The normals that can be turned, (3, m); None if there are none, or all are zero."""
        if not set(NORMAL_NAMES) <= set(self.names):
            return None
        if any(self.rows.dtype[name].kind != "f" for name in NORMAL_NAMES):
            return None
        normals = np.stack([self.rows[name] for name in NORMAL_NAMES], dtype=np.float64)
        return normals if normals.any() else None

    @property
    def notes(self) -> tuple[str, ...]:
        """What cannot be done to its properties, one sentence each."""
        held = [name for name in NORMAL_NAMES if name in self.names]
        is_given = any(self.rows[name].any() for name in held)
        if not is_given or self.normals is not None:
            return ()
        why = "are whole numbers" if len(held) == 3 else f"are not all of {', '.join(NORMAL_NAMES)}"
        return (
            f"its normals ({', '.join(held)}) {why} and keep their values; compute them again from "
            "the points that are written",
        )

    def encode(self, rows: NDArray[Any]) -> bytes:
        """Return the file with other properties.

        Raises
        ------
        OutputError
            When a position is too large for the type of its property, or another number for half
            precision, which alone is narrower than what is computed.
        """
        for name in self.names:
            is_half = self.rows.dtype[name] == np.float16
            if name not in POSITION_NAMES and not is_half:
                continue
            if (np.isfinite(self.rows[name]) & ~np.isfinite(rows[name])).any():
                raise OutputError(
                    f"a moved `{name}` is too large for its type, {rows.dtype[name].name}; scale "
                    "the animation, or give a file whose properties are double"
                )
        return b"".join((self.head, rows.data.cast("B"), self.tail))


def parse_points(data: bytes) -> PointFile | None:
    """Parse the content of a PLY file; None if it has faces, or is no PLY file.

    Raises
    ------
    FormatError
        When it is a cloud of points that is damaged or cannot be used.
    """
    found = _find_header(data)
    if found is None:
        return None
    head, is_text = found
    try:
        order, elements, _ = parse_header(head)
    except (KeyError, ValueError, IndexError, OverflowError):
        return None  # the reader of meshes says what is wrong
    counts = {element.name: element.count for element in elements}
    if counts.get(b"face", 0) > 0 or b"vertex" not in counts:
        return None
    vertex, body = elements[0], memoryview(data)[_end_of_header(data) :]
    _check_elements(elements)
    kind = make_row_dtype(vertex, order, {})
    smallest = 2 * len(vertex.type_codes) - 1 if is_text else kind.itemsize
    if vertex.count * smallest > len(body) + is_text:
        raise FormatError(
            f"announces {vertex.count} points of at least {smallest} bytes, but {len(body)} bytes "
            "follow; it is cut short, export it again"
        )
    if is_text:
        return PointFile(head, _parse_text(bytes(body), elements, kind), b"")
    size = vertex.count * kind.itemsize
    rows = np.frombuffer(body[:size], kind)
    return PointFile(head, rows, bytes(body[size:]))


def _find_header(data: bytes) -> tuple[bytes, bool] | None:
    """Return the header as that of a binary file, and whether it is that of a text."""
    end = _end_of_header(data)
    if not data.startswith(b"ply") or not end:
        return None
    if is_binary_ply(data):
        return data[:end], False
    head = data[:end].replace(b"format ascii", b"format binary_little_endian", 1)
    return head, True


def _end_of_header(data: bytes) -> int:
    """Return where the header ends, or 0 if it does not."""
    mark = data.find(_END, 0, MAX_HEADER_BYTES)
    return data.find(b"\n", mark) + 1 if mark >= 0 else 0


def _check_elements(elements: list[Element]) -> None:
    """Refuse a header that cannot be that of points to be moved."""
    vertex = elements[0]
    names = [name.decode("utf-8", "replace") for name in vertex.type_codes]
    for element in elements:
        if element.count < 0:
            shown = element.name.decode("utf-8", "replace")
            raise FormatError(
                f"its header says `element {shown} {element.count}`, which is not a valid count; "
                "export it again"
            )
    if vertex.name != b"vertex":
        before = vertex.name.decode("utf-8", "replace")
        hint = "; if it is a compressed splat file, export it uncompressed"
        raise FormatError(f"has `{before}` before its points, expected the points first{hint}")
    if not all(name.isascii() for name in names):
        raise FormatError("has a property whose name is not plain text; rename it")
    if vertex.count == 0:
        raise FormatError("has no points; export it again")
    if has_lists(vertex):
        raise FormatError("has a list among the properties of its points; export it without")
    for axis in POSITION_NAMES:
        code = vertex.type_codes.get(axis.encode())
        if code is None:
            shown = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
            raise FormatError(f"its points have no property `{axis}` (found {shown}); export it")
        if code not in "efd":
            raise FormatError(f"its `{axis}` is a whole number, expected float or double")


def _parse_text(body: bytes, elements: list[Element], kind: np.dtype[Any]) -> NDArray[Any]:
    """Read the rows of the points of a text."""
    others = [e.name.decode("utf-8", "replace") for e in elements[1:] if e.count]
    if others:
        raise FormatError(
            f"is a text that has `{others[0]}` besides its points; export the points alone, or as "
            "a binary file"
        )
    count = elements[0].count
    try:
        rows = np.loadtxt(io.BytesIO(body), kind, comments=None, ndmin=1, max_rows=count + 1)
    except (ValueError, OverflowError, struct.error) as error:
        width = len(kind.names or ())
        raise FormatError(
            f"is not a sound PLY file (its points are not rows of {width} numbers that fit their "
            "types); export it again"
        ) from error
    if len(rows) != count:
        more = "more" if len(rows) > count else str(len(rows))
        raise FormatError(f"announces {count} points, holds {more}; export it again")
    return rows


def place_positions(rows: NDArray[Any], positions: Floats) -> None:
    """Put positions, (m, 3), into rows; one too large for its type becomes infinite."""
    with np.errstate(over="ignore"):
        for axis, values in zip(POSITION_NAMES, positions.T, strict=True):
            rows[axis] = values


def place_normals(rows: NDArray[Any], normals: Floats) -> None:
    """Put normals, (3, m), into rows."""
    for axis, values in zip(NORMAL_NAMES, normals, strict=True):
        rows[axis] = values


def place_moved(rows: NDArray[Any], moved: NDArray[Any]) -> None:
    """Put positions, (m, 3), or rows of `MOVED` into rows."""
    if moved.dtype.names is None:
        place_positions(rows, moved)
        return
    place_positions(rows, np.stack([moved[axis] for axis in POSITION_NAMES], axis=1))
    place_normals(rows, np.stack([moved[axis] for axis in NORMAL_NAMES]))


class PointWriter(FrameFileWriter):
    """Writes a file per frame that differs from the one that was read in what is moved.

    Frames are positions, or rows of `MOVED`.
    """

    def __init__(self, target: Path, animation: Animation, points: PointFile) -> None:
        super().__init__(target, animation)
        self._points = points

    def encode_frame(self, positions: NDArray[Any]) -> bytes:
        """Return the bytes of one frame."""
        rows = self._points.rows.copy()
        place_moved(rows, positions)
        return self._points.encode(rows)
