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

from cageik_cli.formats.base.writers import Animation, FrameFileWriter
from cageik_cli.formats.ply import (
    Element,
    has_lists,
    is_binary_ply,
    make_row_dtype,
    parse_header,
    stack_positions,
)
from cageik_cli.geometry.ellipsoids import Ellipsoids
from cageik_cli.geometry.oriented import Splats
from cageik_cli.geometry.spherical_harmonics import REST_COUNTS
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


SCALES = tuple(f"scale_{k}" for k in range(3))
TURNS = tuple(f"rot_{k}" for k in range(4))
COLOURS = tuple(f"f_dc_{k}" for k in range(3))
OPACITY = "opacity"

MAX_LOG_SCALE = 80.0
"""Largest size of the logarithm of a standard deviation."""

MAX_COLOUR = 1e30
"""Largest size of a coefficient of a colour: in single precision, its sums stay finite."""


def holds_splats(points: PointFile) -> bool:
    """Return whether points are Gaussian splats, by the names of their properties."""
    return {SCALES[0], TURNS[0]} <= set(points.names)


def rest_names(points: PointFile) -> tuple[str, ...]:
    """Return the names of the coefficients beyond the constant ones, in the file's order."""
    count = sum(name.startswith("f_rest_") for name in points.names)
    return tuple(f"f_rest_{k}" for k in range(count))


def read_splats(points: PointFile) -> Splats:
    """Read what a deformation changes of splats, besides their places.

    Raises
    ------
    FormatError
        Naming the property and the first splat at fault.
    """
    rest = rest_names(points)
    for name in (*SCALES, *TURNS, *COLOURS, OPACITY, *rest):
        if name not in points.names:
            raise FormatError(
                f"is a file of Gaussian splats without `{name}`; export all properties"
            )
        if points.rows.dtype[name].kind != "f":
            raise FormatError(f"its `{name}` is a whole number, expected float or double")
    if len(rest) not in {3 * count for count in REST_COUNTS}:
        raise FormatError(
            f"has {len(rest)} properties f_rest_*, expected 0, 9, 24 or 45 (degrees 0 to 3 of "
            "spherical harmonics)"
        )
    logs = _stack(points, SCALES, MAX_LOG_SCALE)
    colours = _stack(points, rest, MAX_COLOUR).astype(np.float32)
    _stack(points, COLOURS, MAX_COLOUR)  # what is kept is checked, too
    _stack(points, (OPACITY,))
    colours = colours.reshape(3, len(rest) // 3, len(points.rows))
    return Splats(Ellipsoids(np.exp(logs), _read_quaternions(points)), colours)


def _read_quaternions(points: PointFile) -> Floats:
    """Return the quaternions with length one, (4, m)."""
    turns = _stack(points, TURNS)
    largest = np.abs(turns).max(axis=0)
    _refuse(points, TURNS[:1], (largest == 0)[None], "a quaternion that is not zero")
    turns /= largest  # the squares of its numbers may be too large or small for their type
    return np.asarray(turns / np.linalg.norm(turns, axis=0))


def _stack(points: PointFile, names: tuple[str, ...], limit: float = np.inf) -> Floats:
    """Return some properties as float64, (count, m), all finite and of at most this size."""
    values = np.empty((len(names), len(points.rows)))
    with np.errstate(invalid="ignore"):
        for row, name in zip(values, names, strict=True):
            row[:] = points.rows[name]
    _refuse(points, names, ~np.isfinite(values), "a finite number")
    _refuse(points, names, np.abs(values) > limit, f"at most {limit:g} in size")
    return values


def _refuse(
    points: PointFile, names: tuple[str, ...], is_wrong: NDArray[np.bool_], expected: str
) -> None:
    """Raise FormatError for the first wrong entry, (count, m), if there is one."""
    if is_wrong.any():
        place = int(is_wrong.any(axis=0).argmax())
        name = names[int(is_wrong[:, place].argmax())]
        raise FormatError(
            f"`{name}` of splat {place} (from 0) is {points.rows[name][place]:g}, expected "
            f"{expected}; remove the splat, or export the file again"
        )


def place_splats(rows: NDArray[Any], splats: Splats) -> None:
    """Put moved splats into rows; logarithms are at least −`MAX_LOG_SCALE`."""
    logs = np.maximum(np.log(splats.ellipsoids.axes), -MAX_LOG_SCALE)
    for names, values in ((SCALES, logs), (TURNS, splats.ellipsoids.quaternions)):
        for name, row in zip(names, values, strict=True):
            rows[name] = row
    with np.errstate(over="ignore"):  # only half precision is too narrow
        for k, row in enumerate(splats.harmonics.reshape(-1, len(rows))):
            rows[f"f_rest_{k}"] = row


class SplatWriter(FrameFileWriter):
    """Writes a file per frame: rows of splats, in the layout of the file that was read."""

    def __init__(self, target: Path, animation: Animation, points: PointFile) -> None:
        super().__init__(target, animation)
        self._points = points

    def encode_frame(self, positions: NDArray[Any]) -> bytes:
        """Return the bytes of one frame, given its rows."""
        return self._points.encode(positions)
