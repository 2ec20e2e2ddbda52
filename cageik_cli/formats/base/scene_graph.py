"""Meshes in scenes: polygons of either winding, moved by transforms, sampled in time."""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.formats.base.readers import ClipFile
from cageik_cli.formats.base.sequence import ClipRequest
from cageik_cli.formats.settings import SceneHints
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface_attributes import SurfaceAttributes
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import (
    ConnectivityError,
    FormatError,
    SettingError,
    error_context,
    join_truncated,
)

Polygons = tuple[Integers, Integers]
"""How many corners each face has, (p,), and the vertices of the corners, face after face."""

EVEN_STEP_TOL = 1e-4
"""Steps that differ by more than this fraction of their mean are uneven."""


class SceneReader(ClipFile):
    """Frames of one mesh in the space of its scene, evaluated on demand.

    Formats open a scene, list its meshes, and say what one of them is at a time, in seconds or in
    time codes.

    Attributes
    ----------
    is_clockwise : bool
        Whether the faces of the mesh wind clockwise; set by `open_mesh`.
    winding_note : str
        What a user is told of such faces; nothing where all files of the format have them.
    """

    has_members = True
    is_clockwise: bool
    winding_note = ""

    @abstractmethod
    def check_file(self, path: Path) -> None:
        """Refuse a file, or a missing library, before the library opens the file."""

    @abstractmethod
    def guard(self) -> AbstractContextManager[list[str]]:
        """Turn what the library raises inside into a FormatError; yield its warnings at the end."""

    @abstractmethod
    def list_meshes(self, path: Path) -> dict[str, Any]:
        """Open the file; return its meshes by their paths in the scene."""

    @abstractmethod
    def open_mesh(self, mesh: Any) -> None:
        """Take one of these meshes: what follows is about it."""

    @abstractmethod
    def list_times(self) -> set[float]:
        """List when the points are sampled, or the transforms; nothing if none of them moves."""

    @abstractmethod
    def replace_uneven(self, times: Floats) -> tuple[Floats, str]:
        """Return the times of frames in place of uneven ones, and a note."""

    @abstractmethod
    def describe_scene(self, times: Floats, step: float | None) -> SceneHints:
        """Return what the file says of the scene; `step` is None for one frame, or uneven ones."""

    @abstractmethod
    def compute_matrix(self, time: float) -> Floats:
        """Return the transform of the mesh into the scene, (4, 4), which multiplies rows."""

    @abstractmethod
    def has_moving_transform(self) -> bool:
        """Return whether a transform of the mesh has several samples."""

    @abstractmethod
    def read_points(self, time: float) -> NDArray[np.floating]:
        """Read the points in the space of the mesh, (m, 3)."""

    @abstractmethod
    def list_polygon_times(self) -> Sequence[float]:
        """List when faces are sampled: at least one time, or the number of one sample."""

    @abstractmethod
    def read_polygons(self, time: float) -> Polygons:
        """Read the faces at one of these times."""

    @abstractmethod
    def list_surface_parts(
        self, vertex_count: int, time: float
    ) -> dict[str, Callable[[SurfaceAttributes], SurfaceAttributes]]:
        """Return what reads the parts of the surface, for `FileMesh.read_parts`."""

    def __init__(self, request: ClipRequest) -> None:
        path = request.path
        with error_context(path):
            self.check_file(path)
            with self.guard() as warnings:
                notes = self._open_clip(path, request)
        self.notes = tuple(f"{path.name}: {note}" for note in (*notes, *warnings))

    def read_positions(self, index: int) -> Floats:
        """Read the vertices of one frame."""
        with error_context(self.location(index)), self.guard():
            return self._read_moved(self._times[index])

    def _open_clip(self, path: Path, request: ClipRequest) -> list[str]:
        """Find the mesh and its frames; return notes on what was changed."""
        meshes, notes = self.list_meshes(path), []
        self.open_mesh(meshes[choose_mesh(list(meshes), request.member)])
        times = np.array(sorted(self.list_times() or {0.0}))
        step = find_step(times)
        if step is None and len(times) > 1:
            times, note = self.replace_uneven(times)
            step = find_step(times)
            notes.append(note)
        self.set_frames(request, len(times), self.describe_scene(times, step))
        self._times = times[list(self.frame_indices)].tolist()
        mesh = self._read_mesh(request.complete_first(self._read_moved(self._times[0])))
        self.first = mesh.make_mesh()
        if self.is_clockwise and self.winding_note:
            notes.append(self.winding_note)
        return [*notes, *self._describe_transform(), *mesh.notes]

    def _read_moved(self, time: float) -> Floats:
        return transform_points(self.read_points(time), self.compute_matrix(time))

    def _read_mesh(self, points: Floats) -> FileMesh:
        """Return the mesh of the first frame, its surface included."""
        time = self._times[0]
        counts, corners = read_constant_polygons(self.read_polygons, self.list_polygon_times())
        check_corner_counts(counts, corners)
        mesh = FileMesh(points, corners.astype(np.int64), counts.astype(np.int64))
        TriMesh(points, mesh.fans)  # names vertices that are not there
        mesh = mesh.read_parts(self.list_surface_parts(len(points), time))
        is_inside_out = self.is_clockwise != is_mirroring(self.compute_matrix(time))
        return mesh.turn_faces() if is_inside_out else mesh

    def _describe_transform(self) -> list[str]:
        """Return a note on a mesh that its transform has moved."""
        if self.has_moving_transform():
            return ["moved by its animated transform into the scene's space"]
        if not np.array_equal(self.compute_matrix(self._times[0]), np.eye(4)):
            return ["moved by its transform into the scene's space"]
        return []


def read_constant_polygons(
    read_at: Callable[[float], Polygons], times: Iterable[float]
) -> Polygons:
    """Read the faces at the first of some times, and check that they never change."""
    first, *others = times
    found = read_at(first)
    for time in others:
        if not all(map(np.array_equal, read_at(time), found)):
            raise ConnectivityError(
                f"the faces change at time {time:g}; all frames must share one connectivity"
            )
    return found


def check_corner_counts(counts: Integers, corners: Integers) -> None:
    """Refuse faces whose counts are not those of their corners; raises FormatError."""
    total = int(counts.sum(dtype=np.int64))
    if len(counts) == 0 or counts.min() < 0 or total != len(corners):
        raise FormatError(
            f"{len(counts)} faces need {total} corners, found {len(corners)}; export the mesh again"
        )


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


def find_step(times: Floats) -> float | None:
    """Return the step between ascending times, (F,); None for a single one, or uneven ones."""
    steps = np.diff(times)
    if len(steps) == 0:
        return None
    mean = float(times[-1] - times[0]) / len(steps)
    return mean if (np.abs(steps - mean) <= EVEN_STEP_TOL * mean).all() else None


def round_frame_step(step: float | None) -> float | None:
    """Return a step of frame numbers without the digits of rounding errors; None for 1."""
    rounded = None if step is None else round(step, 6)
    return None if rounded == 1 else rounded


def choose_mesh(meshes: list[str], member: str | None) -> str:
    """Return the mesh that `member` names, or the only one."""
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
