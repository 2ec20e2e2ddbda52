"""PLY files of points without faces: their positions, and all other properties as they are.

Binary files are written as they were read, byte for byte, but for the positions. A text becomes a
little-endian binary file with the same properties.

Gaussian splats are points, as the training of Kerbl et al. 2023 writes them: logarithms of standard
deviations `scale_0` to `scale_2`, a quaternion w, x, y, z `rot_0` to `rot_3` of any length, and
coefficients of spherical harmonics: `f_dc_0` to `f_dc_2`, and `f_rest_*`, first all of red, then of
green and of blue.
"""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.writers import Animation, FrameFileWriter
from cageik_cli.formats.ply import (
    FACE_ELEMENTS,
    NORMAL_NAMES,
    Element,
    PlyRows,
    stack_positions,
)
from cageik_cli.method.points.oriented import REST_COUNTS, Splats
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FormatError, OutputError, join_truncated
from cageik_cli.util.text import group_digits

MOVED = np.dtype([(name, np.float64) for name in (*"xyz", *NORMAL_NAMES)])
"""Places and normals, before they are rounded to the types of a file."""

SCALES = tuple(f"scale_{k}" for k in range(3))

TURNS = tuple(f"rot_{k}" for k in range(4))

COLOURS = tuple(f"f_dc_{k}" for k in range(3))

MAX_LOG_SCALE = 80.0
"""Largest size of the logarithm of a standard deviation."""

MAX_COLOUR = 1e30
"""Largest size of a coefficient of a colour: in single precision, its sums stay finite."""


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
            if name not in ("x", "y", "z") and not is_half:
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
    try:
        file = PlyRows(data)
    except (ValueError, IndexError, OverflowError):
        return None  # the reader of meshes says what is wrong
    counts = {element.name: element.count for element in file.elements}
    if any(counts.get(name, 0) > 0 for name in FACE_ELEMENTS) or "vertex" not in counts:
        return None
    vertex = file.elements[0]
    _check_points(vertex)
    kind, left = vertex.make_row_dtype(file.order), len(data) - file.head_size
    smallest = 2 * len(vertex.type_codes) - 1 if file.is_text else kind.itemsize
    if vertex.count * smallest > left + file.is_text:
        raise FormatError(
            f"announces {group_digits(vertex.count)} points of at least {smallest} bytes, but "
            f"{left} bytes "
            "follow; it is cut short, export it again"
        )
    head = data[: file.head_size]
    if not file.is_text:
        tail = data[file.head_size + vertex.count * kind.itemsize :]
        return PointFile(head, file.read_rows(vertex), tail)
    head = head.replace(b"format ascii", b"format binary_little_endian", 1)
    return PointFile(head, _read_text_rows(file), b"")


def _check_points(vertex: Element) -> None:
    """Refuse a header whose first element cannot be points to be moved."""
    names = list(vertex.type_codes)
    if vertex.name != "vertex":
        hint = "; if it is a compressed splat file, export it uncompressed"
        raise FormatError(f"has `{vertex.name}` before its points, expected the points first{hint}")
    if not all(name.isascii() for name in names):
        raise FormatError("has a property whose name is not plain text; rename it")
    if vertex.count == 0:
        raise FormatError("has no points; export it again")
    if vertex.lists:
        raise FormatError("has a list among the properties of its points; export it without")
    for axis in "xyz":
        code = vertex.type_codes.get(axis)
        if code is None:
            shown = join_truncated(names)
            raise FormatError(f"its points have no property `{axis}` (found {shown}); export it")
        if code not in "efd":
            raise FormatError(f"its `{axis}` is a whole number, expected float or double")


def _read_text_rows(file: PlyRows) -> NDArray[Any]:
    """Read the rows of the points of a text, which holds nothing else."""
    points, *others = file.elements
    others = [element for element in others if element.count]
    if others:
        raise FormatError(
            f"is a text that has `{others[0].name}` besides its points; export the points alone, "
            "or as a binary file"
        )
    count = file.line_count
    if count != points.count:
        more = "more" if count > points.count else str(count)
        raise FormatError(
            f"announces {group_digits(points.count)} points, holds {more}; export it again"
        )
    try:
        return file.read_rows(points)
    except (ValueError, OverflowError, struct.error) as error:
        raise FormatError(
            f"is not a sound PLY file (its points are not rows of {len(points.type_codes)} numbers "
            "that fit their types); export it again"
        ) from error


def place_positions(rows: NDArray[Any], positions: Floats) -> None:
    """Put positions, (m, 3), into rows; one too large for its type becomes infinite."""
    with np.errstate(over="ignore"):
        for axis, values in zip("xyz", positions.T, strict=True):
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
    place_positions(rows, np.stack([moved[axis] for axis in "xyz"], axis=1))
    place_normals(rows, np.stack([moved[axis] for axis in NORMAL_NAMES]))


class PointWriter(FrameFileWriter):
    """Writes a file per frame that differs from the one that was read in what is moved.

    Frames are positions, rows of `MOVED`, or whole rows as of splats.
    """

    def __init__(self, target: Path, animation: Animation, points: PointFile) -> None:
        super().__init__(target, animation)
        self._points = points

    def encode_frame(self, positions: NDArray[Any]) -> bytes:
        """Return the bytes of one frame."""
        if positions.dtype == self._points.rows.dtype:
            return self._points.encode(positions)
        rows = self._points.rows.copy()
        place_moved(rows, positions)
        return self._points.encode(rows)


def holds_splats(points: PointFile) -> bool:
    """Return whether points are Gaussian splats, by the names of their properties."""
    return {SCALES[0], TURNS[0]} <= set(points.names)


def rest_names(points: PointFile) -> tuple[str, ...]:
    """Return the names of the coefficients beyond the constant ones, in the file's order."""
    count = sum(name.startswith("f_rest_") for name in points.names)
    return tuple(f"f_rest_{k}" for k in range(count))


def read_splats(points: PointFile) -> Splats:
    """Read what a deformation changes of splats, besides their places."""
    rest = rest_names(points)
    for name in (*SCALES, *TURNS, *COLOURS, "opacity", *rest):
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
    _stack(points, ("opacity",))
    colours = colours.reshape(3, len(rest) // 3, len(points.rows))
    turns = _stack(points, TURNS)
    largest = np.abs(turns).max(axis=0)
    _refuse(points, TURNS[:1], (largest == 0)[None], "a quaternion that is not zero")
    turns /= largest  # the squares of its numbers may be too large or small for their type
    return Splats(np.exp(logs), np.asarray(turns / np.linalg.norm(turns, axis=0)), colours)


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
    logs = np.maximum(np.log(splats.axes), -MAX_LOG_SCALE)
    for names, values in ((SCALES, logs), (TURNS, splats.quaternions)):
        for name, row in zip(names, values, strict=True):
            rows[name] = row
    with np.errstate(over="ignore"):  # only half precision is too narrow
        for k, row in enumerate(splats.harmonics.reshape(-1, len(rows))):
            rows[f"f_rest_{k}"] = row
