"""Meshes in scenes: polygons of either winding, moved by transforms, sampled in time."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.mesh_data import FileMesh, fan_triangulate_polygons
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface_attributes import SurfaceAttributes
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import ConnectivityError, FormatError, SettingError, join_truncated

Time = TypeVar("Time", int, float)

SurfaceReader = Callable[[SurfaceAttributes], tuple[SurfaceAttributes, tuple[str, ...]]]


@dataclass(frozen=True, slots=True, eq=False)
class Polygons:
    """Faces as USD and Alembic store them.

    Attributes
    ----------
    corner_counts : (p,) integers
        Number of corners of each.
    corners : (sum of counts,) integers
        Those of one face after those of another.
    """

    corner_counts: NDArray[np.integer]
    corners: NDArray[np.integer]

    def differs_from(self, other: "Polygons") -> bool:
        """Return whether others are different."""
        return not (
            np.array_equal(self.corner_counts, other.corner_counts)
            and np.array_equal(self.corners, other.corners)
        )

    def make_mesh(
        self, points: Floats, is_clockwise: bool, read_surface: SurfaceReader | None = None
    ) -> FileMesh:
        """Make a mesh with these points.

        Parameters
        ----------
        points : (m, 3)
        is_clockwise : bool
            Whether the faces wind clockwise.
        read_surface : callable, optional
            Completes the attributes of the polygons, in the order of the file, and returns notes
            on what is left out.

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
                f"{len(self.corner_counts)} faces need {total} corners, found {len(self.corners)}; "
                "export the mesh again"
            )
        polygons = np.split(self.corners, np.cumsum(self.corner_counts)[:-1])
        if is_clockwise:
            polygons = [polygon[::-1] for polygon in polygons]
        mesh = FileMesh(points, *fan_triangulate_polygons(polygons))
        if read_surface is None:
            return mesh
        TriMesh(points, mesh.faces)  # names vertices that are not there
        counts, corners = (a.astype(np.int64) for a in (self.corner_counts, self.corners))
        found, left_out = read_surface(SurfaceAttributes(counts, corners))
        attributes = found.reverse(keeps_first=False) if is_clockwise else found
        return replace(mesh, attributes=attributes, left_out=left_out)


def read_constant_polygons(read_at: Callable[[Time], Polygons], times: Iterable[Time]) -> Polygons:
    """Read the faces at the first of some times, and check that they never change.

    Raises
    ------
    InputError
        Naming the time at which they change.
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
    """Transform points (m, 3), as rows, by a matrix (4, 4)."""
    exact = np.asarray(points, np.float64)
    if np.array_equal(matrix, np.eye(4)):
        return exact
    with np.errstate(over="ignore", invalid="ignore"):  # checked when the frame is read
        return np.asarray(exact @ matrix[:3, :3] + matrix[3, :3])


def is_mirroring(matrix: Floats) -> bool:
    """Return whether a matrix turns a surface inside out."""
    return bool(np.linalg.det(matrix[:3, :3]) < 0)


def describe_transform(matrix: Floats, is_animated: bool) -> list[str]:
    """Return a note on a mesh that its transform, `matrix` at the first frame, has moved."""
    if is_animated:
        return ["moved by its animated transform into the scene's space"]
    if not np.array_equal(matrix, np.eye(4)):
        return ["moved by its transform into the scene's space"]
    return []


EVEN_STEP_TOL = 1e-4
"""Steps that differ by more than this fraction of their mean are uneven."""


@dataclass(frozen=True, slots=True, eq=False)
class Sampling:
    """The times of the frames of a clip.

    Attributes
    ----------
    times : (F,)
        Ascending, seconds or time codes.
    step : float or None
        From one frame to the next; None for a single frame, or when steps differ.
    """

    times: Floats
    step: float | None

    @staticmethod
    def from_times(times: set[float]) -> "Sampling":
        """Sample at `times`; at time 0 if there are none."""
        ordered = np.array(sorted(times or {0.0}))
        steps = np.diff(ordered)
        if len(steps) == 0:
            return Sampling(ordered, None)
        mean = float(ordered[-1] - ordered[0]) / len(steps)
        even = bool((np.abs(steps - mean) <= EVEN_STEP_TOL * mean).all())
        return Sampling(ordered, mean if even else None)

    @property
    def is_uneven(self) -> bool:
        """Whether the steps differ."""
        return self.step is None and len(self.times) > 1


def frames_per_second(step: float) -> float:
    """Convert seconds per frame to frames per second, without the digits of rounding errors."""
    return round(1 / step, 9)


def round_frame_step(step: float | None) -> float | None:
    """Return a step of frame numbers without the digits of rounding errors; None for 1."""
    rounded = None if step is None else round(step, 6)
    return None if rounded == 1 else rounded


def choose_mesh(meshes: list[str], member: str | None) -> str:
    """Return the mesh that `member` names, or the only one.

    Raises
    ------
    InputError
        Listing the meshes to choose from.
    """
    if not meshes:
        raise FormatError("holds no mesh; export an animated mesh")
    if member is not None and member not in meshes:
        raise SettingError(f"holds no mesh `{member}`; choose one of {join_truncated(meshes)}")
    if member is None and len(meshes) > 1:
        raise SettingError(
            f"holds {len(meshes)} meshes, expected one: {join_truncated(meshes)}; "
            f"choose one, as in FILE::{meshes[0]}"
        )
    return meshes[0] if member is None else member
