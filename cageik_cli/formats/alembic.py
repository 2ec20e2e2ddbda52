"""A clip in Alembic: a polygon mesh whose points, or whose transforms, have samples."""

import errno
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from cageik_cli.formats.alembic_surface import AlembicSurface, find_cause, list_layers, read_sample
from cageik_cli.formats.alembic_tree import (
    SAME_TIME_TOL,
    TransformTree,
    find_transforms,
    interpolate_matrix,
    is_still,
    locate_samples,
    name_parts,
    place_meshes,
)
from cageik_cli.formats.base.files import ClaimedBytes
from cageik_cli.formats.base.scene_graph import (
    LibraryError,
    Polygons,
    SceneMesh,
    SceneReader,
    round_frame_step,
)
from cageik_cli.formats.base.writers import Animation, AnimationWriter
from cageik_cli.formats.settings import SceneHints, find_frame_step
from cageik_cli.geometry.surface_attributes import SurfaceAttributes
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import (
    ConnectivityError,
    FileAccessError,
    FormatError,
    require_optional,
)
from cageik_cli.util.files import open_input

FPS_KEY = "cageik_fps"
"""Where a mesh states the frame rate. The archive could only state it together with the time."""


class Reader(SceneReader):
    """Frames of the polygon meshes of an archive; times are seconds."""

    suffixes = (".abc",)
    library = "alembic3d"

    def check_file(self, path: Path) -> None:
        """Refuse what the library would open as an empty archive, or not at all."""
        require_alembic("reading .abc")
        _check_header(path)
        self._lock = Lock()  # the library's streams are not thread-safe

    @contextmanager
    def guard(self) -> Iterator[list[str]]:
        """Convert errors; one thread at a time."""
        try:
            with self._lock:
                yield []
        except (RuntimeError, IndexError, UnicodeDecodeError) as error:
            cause = find_cause(error)
            raise LibraryError(f"is not a sound Alembic file ({cause}); export it again") from error

    def list_meshes(self, path: Path) -> tuple[dict[str, Any], dict[str, str]]:
        """Open the archive."""
        from alembic3d.Abc import IArchive
        from alembic3d.AbcGeom import IPolyMesh

        self._archive, self._claimed = IArchive(str(path)), ClaimedBytes(path.stat().st_size)
        self._stated_rates: list[str] = []
        objects = _iterate_descendants(self._archive.getTop())
        meshes = [thing for thing in objects if IPolyMesh.matches(thing.getHeader())]
        paths = [thing.getFullName() for thing in meshes]
        names = name_parts(paths, [is_still(thing) for thing in meshes])
        self._names = dict(zip(paths, names, strict=True))
        hidden = [name for name, thing in zip(names, meshes, strict=True) if _is_hidden(thing)]
        return dict(zip(names, meshes, strict=True)), dict.fromkeys(hidden, "invisible")

    def find_top(self, member: str | None) -> str | None:
        """Return the part of a mesh that is named by its own path."""
        return self._names.get(member, member) if member else member

    def open_mesh(self, found: Any) -> "AlembicMesh":
        """Open an object."""
        self._stated_rates.append(found.getMetaData().get(FPS_KEY))
        return AlembicMesh(found, self._claimed)

    def list_times(self, meshes: Sequence[SceneMesh]) -> set[float]:
        """List when the meshes are sampled, each time once."""
        times = np.array(sorted(super().list_times(meshes)))
        mean = np.ptp(times) / len(times) if len(times) else 0.0
        steps = np.diff(times, prepend=-np.inf)
        return set(times[steps > SAME_TIME_TOL * mean].tolist())

    def replace_uneven(self, times: Floats) -> tuple[Floats, str]:
        """Keep uneven samples."""
        note = f"its {len(times)} samples are not evenly spaced in time; each is used as one frame"
        return times, note

    def describe_scene(self, times: Floats, step: float | None) -> SceneHints:
        """Return frame rate and frame numbers, of whole frames if a rate is stated.

        Alembic knows seconds only. Without a rate, the step is the smallest that makes the number
        of the first frame whole, to 1e-4 frames.
        """
        if step is None:
            return SceneHints()
        fps, seconds = _read_frame_rate(self._archive, self._stated_rates), float(times[0])
        frame_step = round_frame_step(step * fps) if fps is not None else None
        if fps is None or (frame_step is not None and frame_step != int(frame_step)):
            fps = round(1 / step, 9)  # without the digits of rounding errors
            frame_step = find_frame_step(seconds * fps, tolerance=1e-4)
            fps *= frame_step or 1
        return SceneHints(fps=fps, start=round(seconds * fps, 6), frame_step=frame_step)


class AlembicMesh(SceneMesh):
    """A polygon mesh; times are seconds."""

    is_clockwise = True  # in all files

    def __init__(self, thing: Any, claimed: ClaimedBytes) -> None:
        from alembic3d.Abc import WrapExistingFlag
        from alembic3d.AbcGeom import IPolyMesh

        self._schema = IPolyMesh(thing, WrapExistingFlag.kWrapExisting).getSchema()
        self._claimed, self._points = claimed, self._schema.getPositionsProperty()
        self._transforms = find_transforms(thing)

    def list_times(self) -> set[float]:
        """List the times of the points, or of the transforms if the points do not move."""
        times = _sample_times(self._points)
        if len(times) < 2:
            times = set().union(*map(_sample_times, self._transforms), times)
        return times

    def compute_matrix(self, time: float) -> Floats:
        """Return the product of the transforms."""
        matrix = np.eye(4)
        for transform in self._transforms:
            matrix = matrix @ interpolate_matrix(transform, time)
        return matrix

    def has_moving_transform(self) -> bool:
        """Return whether a transform has several samples."""
        return any(transform.getNumSamples() > 1 for transform in self._transforms)

    def read_points(self, time: float) -> np.ndarray:
        """Read the points at a time, interpolated linearly between two samples."""
        start, stop, part = locate_samples(self._points, time)
        before, after = (
            np.array(read_sample(self._points, index, self._claimed.packed), np.float32).reshape(
                -1, 3
            )
            for index in (start, stop)
        )
        if len(after) != len(before):
            raise ConnectivityError(
                f"{len(after)} vertices in sample {stop}, expected {len(before)} as in sample "
                f"{start}; all must share one connectivity"
            )
        return before if part == 0 else before + part * (after.astype(np.float64) - before)

    def list_polygon_times(self) -> range:
        """List the numbers of the samples of the faces."""
        properties = self._polygon_properties
        return range(max(1 if p.isConstant() else p.getNumSamples() for p in properties))

    def read_polygons(self, time: float) -> Polygons:
        """Read the faces of a sample."""
        size = self._claimed.packed
        counts, corners = (
            np.array(read_sample(p, min(int(time), p.getNumSamples() - 1), size), np.int64)
            for p in self._polygon_properties
        )
        self._claimed.claim(4 * (len(counts) + len(corners)))
        return counts, corners

    def list_surface_layers(
        self, vertex_count: int, time: float
    ) -> dict[str, Callable[[SurfaceAttributes], SurfaceAttributes]]:
        """Return what reads UVs, normals and face sets, in the first sample."""
        self._claimed.claim(12 * vertex_count)
        return list_layers(self._schema, self._claimed)

    @property
    def _polygon_properties(self) -> tuple[Any, Any]:
        return self._schema.getFaceCountsProperty(), self._schema.getFaceIndicesProperty()


def require_alembic(purpose: str) -> None:
    """Raise MissingLibraryError without alembic3d, which is needed for a purpose."""
    with require_optional("alembic3d", purpose):
        import alembic3d  # noqa: F401


def _check_header(path: Path) -> None:
    """Refuse files that are not Alembic, or not complete."""
    with open_input(path) as stream:
        try:
            header = stream.read(16)
        except OSError as error:
            raise FileAccessError(f"cannot be read: {error.strerror or error}") from error
    if header.startswith(b"\x89HDF"):
        raise FormatError("is an old Alembic file, in HDF5; convert it with abcconvert -toOgawa")
    if not header.startswith(b"Ogawa"):
        raise FormatError("is not an Alembic file; export it again")
    # A byte that is set when the file is closed, and the place of its root, at the end.
    if header[5:6] != b"\xff" or int.from_bytes(header[8:], "little") >= path.stat().st_size:
        raise FormatError(
            "is cut short, or was not closed by the program that wrote it; export it again"
        )


def _iterate_descendants(thing: Any) -> Iterator[Any]:
    for child in thing.children:
        yield child
        yield from _iterate_descendants(child)


def _sample_times(sampled: Any) -> set[float]:
    """Return the times of the samples, if there are several."""
    count = sampled.getNumSamples()
    sampling = sampled.getTimeSampling()
    return {sampling.getSampleTime(k) for k in range(count)} if count > 1 else set()


def _is_hidden(thing: Any) -> bool:
    """Return whether an object, or one that it is below, is invisible in its first sample."""
    from alembic3d.Abc import ISampleSelector
    from alembic3d.AbcGeom import IsAncestorInvisible

    return bool(IsAncestorInvisible(thing, ISampleSelector(0)))


def _read_frame_rate(archive: Any, stated: list[str]) -> float | None:
    """Return the frames per second that cageik or another program states; None if none does.

    `stated` is what the meshes say.
    """
    from alembic3d.Abc import GetArchiveInfo

    for value in (*stated, GetArchiveInfo(archive).get("dccFPS")):
        try:
            fps = float(value or 0)
        except ValueError:
            continue
        if 0 < fps < float("inf"):
            return fps
    return None


class Writer(AnimationWriter):
    """Each frame at its number / fps seconds, of each part at its path; faces turn clockwise there.

    A mesh that came as one is `/NAME`.
    """

    suffixes = (".abc",)
    is_single = True
    keeps_parts = True

    @classmethod
    def require_libraries(cls) -> None:
        """Raise MissingLibraryError without alembic3d."""
        require_alembic("writing .abc")

    def __init__(self, target: Path, animation: Animation) -> None:
        self.require_libraries()
        from alembic3d.Abc import OArchive
        from alembic3d.AbcCoreAbstract import MetaData, TimeSampling
        from alembic3d.AbcGeom import OPolyMesh

        _check_disk_space(target, animation)
        scene, parts = animation.scene, animation.split()
        try:
            # With a name of the program, the archive would hold the time, too.
            archive = OArchive(str(target))
            step, start = scene.frame_step / scene.fps, scene.start / scene.fps
            times = archive.addTimeSampling(TimeSampling(step, start))
            stated = MetaData()
            stated.set(FPS_KEY, f"{scene.fps:.12g}")
            paths = [f"/{part.name.strip('/')}" for part in parts]
            are_still = [np.array_equal(part.transform, np.eye(4)) for part in parts]
            places = [path.rpartition("/") for path in place_meshes(paths, are_still)]
            matrices: dict[str, Floats] = {}
            for (above, _, _), part in zip(places, parts, strict=True):
                matrices.setdefault(above, part.transform)
            tree = TransformTree(archive.getTop(), matrices)
            # The last references to the file: it is closed with these.
            self._meshes = []
            for (above, _, name), part in zip(places, parts, strict=True):
                schema = OPolyMesh(tree.define(above), name, stated, times).getSchema()
                self._meshes.append((schema, AlembicSurface(part.own_mesh), part))
        except RuntimeError as error:
            raise OSError(str(error)) from error

    def append(self, frames: Floats) -> None:
        """Write the next frames."""
        for positions in frames:
            for schema, surface, part in self._meshes:
                schema.set(surface.make_sample(part.select(positions)))

    def complete(self) -> None:
        """Write what is of all frames, and close the file."""
        for schema, surface, _ in self._meshes:
            surface.write_face_sets(schema)
        self.abandon()

    def abandon(self) -> None:
        """Close the file."""
        self.__dict__.pop("_meshes", None)


def _check_disk_space(target: Path, animation: Animation) -> None:
    """Refuse what does not fit: Alembic ends the process when its last write fails."""
    rest = animation.rest
    corners = 0 if rest.attributes is None else len(rest.attributes.corners)
    size = 12 * animation.frame_count * (len(rest.vertices) + corners) + 16 * len(rest.faces)
    size += 1 << 16  # at most, besides the arrays
    if size > shutil.disk_usage(target.parent).free:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
