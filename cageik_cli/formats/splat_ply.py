"""PLY files of Gaussian splats, as the training of Kerbl et al. 2023 writes them.

Logarithms of standard deviations `scale_0` to `scale_2`, a quaternion w, x, y, z `rot_0` to
`rot_3` of any length, and coefficients of spherical harmonics: `f_dc_0` to `f_dc_2`, and
`f_rest_*`, first all of red, then of green and of blue.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.writer import Animation, FrameFileWriter
from cageik_cli.formats.points_ply import PointFile
from cageik_cli.geometry.ellipsoids import Ellipsoids
from cageik_cli.geometry.oriented import Splats
from cageik_cli.geometry.spherical_harmonics import REST_COUNTS
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FormatError

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
