"""Meshes that stand in a scene: polygons of either winding, moved by transforms."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.formats.base.polygons import fan_triangulate_polygons
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import ConnectivityError, FormatError, SettingError, join_truncated

Time = TypeVar("Time", int, float)


@dataclass(frozen=True, slots=True, eq=False)
class Polygons:
    """Faces as scenes have them.

    Attributes
    ----------
    corner_counts : (p,) integers
        How many corners each has.
    corners : (sum of counts,) integers
        One face's after the other's.
    """

    corner_counts: NDArray[np.integer]
    corners: NDArray[np.integer]

    def differs_from(self, other: "Polygons") -> bool:
        """Whether the others are not the same."""
        return not (
            np.array_equal(self.corner_counts, other.corner_counts)
            and np.array_equal(self.corners, other.corners)
        )

    def make_mesh(self, points: Floats, is_clockwise: bool) -> FileMesh:
        """The mesh they make of points; `is_clockwise` when they wind clockwise.

        Raises
        ------
        InputError
            When counts and corners do not agree.
        """
        total = int(self.corner_counts.sum(dtype=np.int64))
        if (
            len(self.corner_counts) == 0
            or self.corner_counts.min() < 0
            or total != len(self.corners)
        ):
            raise FormatError(
                f"{len(self.corner_counts)} faces of {total} corners in all come with "
                f"{len(self.corners)} corners; export the mesh again"
            )
        polygons = np.split(self.corners, np.cumsum(self.corner_counts)[:-1])
        if is_clockwise:
            polygons = [polygon[::-1] for polygon in polygons]
        return FileMesh(points, *fan_triangulate_polygons(polygons))


def read_constant_polygons(read_at: Callable[[Time], Polygons], times: Iterable[Time]) -> Polygons:
    """The faces `read_at` the first of some times, which must be those at all others.

    Raises
    ------
    InputError
        Naming the time at which they are not.
    """
    first, *others = times
    found = read_at(first)
    for time in others:
        if read_at(time).differs_from(found):
            raise ConnectivityError(
                f"the faces change at time {time:g}; all frames must share one connectivity"
            )
    return found


def transform_points(points: NDArray[np.floating], matrix: Floats) -> Floats:
    """Points (m, 3) moved by a matrix (4, 4) that rows are multiplied with."""
    exact = np.asarray(points, np.float64)
    if np.array_equal(matrix, np.eye(4)):
        return exact
    with np.errstate(over="ignore", invalid="ignore"):  # frames are checked where they enter
        return np.asarray(exact @ matrix[:3, :3] + matrix[3, :3])


def is_mirroring(matrix: Floats) -> bool:
    """Whether a matrix turns a surface inside out."""
    return bool(np.linalg.det(matrix[:3, :3]) < 0)


def describe_transform(matrix: Floats, is_animated: bool) -> list[str]:
    """What is said of a mesh that its transform, `matrix` at the first frame, has moved."""
    if is_animated:
        return ["moved by its animated transform into the scene's space"]
    if not np.array_equal(matrix, np.eye(4)):
        return ["moved by its transform into the scene's space"]
    return []


EVEN_STEP_TOL = 1e-4
"""Steps that differ by more than this part of their mean are not even."""


@dataclass(frozen=True, slots=True, eq=False)
class Sampling:
    """When the frames of a clip are.

    Attributes
    ----------
    times : (F,)
        Ascending, seconds or time codes.
    step : float or None
        From one to the next; None for one alone, or when steps differ.
    """

    times: Floats
    step: float | None

    @staticmethod
    def from_times(times: set[float]) -> "Sampling":
        """Frames at `times`; one at time 0 if there are none."""
        ordered = np.array(sorted(times or {0.0}))
        steps = np.diff(ordered)
        if len(steps) == 0:
            return Sampling(ordered, None)
        mean = float(ordered[-1] - ordered[0]) / len(steps)
        even = bool((np.abs(steps - mean) <= EVEN_STEP_TOL * mean).all())
        return Sampling(ordered, mean if even else None)

    @property
    def is_uneven(self) -> bool:
        """Whether steps differ."""
        return self.step is None and len(self.times) > 1


def frames_per_second(step: float) -> float:
    """Frames a second of seconds a frame, without the last digits, which are rounding's."""
    return round(1 / step, 9)


def choose_mesh(meshes: list[str], member: str | None) -> str:
    """The mesh that `member` names, or the only one.

    Raises
    ------
    InputError
        Listing what there is to choose from.
    """
    if not meshes:
        raise FormatError("holds no mesh; export one that is animated")
    if member is not None and member not in meshes:
        raise SettingError(
            f"holds no mesh `{member}`, but {join_truncated(meshes)}; name one of them"
        )
    if member is None and len(meshes) > 1:
        raise SettingError(
            f"holds {len(meshes)} meshes, expected one: {join_truncated(meshes)}; "
            f"name the one behind the file, as in FILE::{meshes[0]}"
        )
    return meshes[0] if member is None else member
