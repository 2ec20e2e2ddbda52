"""A clip in Alembic: a polygon mesh whose points, or whose transforms, have samples."""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from cageik_cli.formats.alembic_surface import AlembicSurface, read_sample, read_surface
from cageik_cli.formats.base.readers import ClipFile, single_path
from cageik_cli.formats.base.scene_graph import (
    Polygons,
    Sampling,
    choose_mesh,
    describe_transform,
    frames_per_second,
    is_mirroring,
    read_constant_polygons,
    round_frame_step,
    transform_points,
)
from cageik_cli.formats.base.sequence import ClipRequest
from cageik_cli.formats.base.writers import Animation, AnimationWriter
from cageik_cli.formats.settings import SceneHints, find_frame_step
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FileAccessError, FormatError, error_context, require_optional
from cageik_cli.util.files import open_input

FPS_KEY = "cageik_fps"
"""Where a mesh states the frame rate. The archive could only state it together with the time."""

ARCHIVE_BYTES = 1 << 16
"""Bytes of an archive besides its arrays, at most."""

START_TOL = 1e-4
"""Frames by which the start of a clip may be off a whole number."""


class Reader(ClipFile):
    """Frames of one polygon mesh in the space of its archive, evaluated on demand."""

    suffixes = (".abc",)
    has_members = True

    def __init__(self, request: ClipRequest) -> None:
        path = single_path(request.paths)
        with error_context(path):
            with require_optional("alembic3d", "abc", "reading .abc"):
                import alembic3d  # noqa: F401
            _check_header(path)
            self._lock = Lock()  # the library's streams are not thread-safe
            with _wrap_alembic_errors():
                notes = self._open_mesh(str(path), request)
        self.notes = tuple(f"{path.name}: {note}" for note in notes)

    def read_positions(self, index: int) -> Floats:
        """Read the vertices of one frame."""
        with error_context(self.location(index)), _wrap_alembic_errors(), self._lock:
            return self._read_points(self._times[index])

    def _open_mesh(self, path: str, request: ClipRequest) -> list[str]:
        """Find the mesh and its frames; return notes on what was changed."""
        from alembic3d.Abc import IArchive, WrapExistingFlag
        from alembic3d.AbcGeom import IPolyMesh

        self._archive = IArchive(path)
        objects = {
            thing.getFullName(): thing for thing in _iterate_descendants(self._archive.getTop())
        }
        meshes = [k for k, thing in objects.items() if IPolyMesh.matches(thing.getHeader())]
        found = objects[choose_mesh(meshes, request.member)]
        self._schema = IPolyMesh(found, WrapExistingFlag.kWrapExisting).getSchema()
        self._points = self._schema.getPositionsProperty()
        self._transforms = _find_transforms(found)
        sampling, notes = self._choose_sampling()
        fps = _read_frame_rate(self._archive, found)
        self.set_frames(request, len(sampling.times), _make_scene_hints(sampling, fps))
        self._times = sampling.times[list(self.frame_indices)].tolist()
        matrix = self._world_matrix(self._times[0])
        # Alembic's faces wind clockwise.
        mesh = self._read_polygons().make_mesh(
            request.complete_first(self._read_points(self._times[0])),
            is_clockwise=not is_mirroring(matrix),
            read_surface=partial(read_surface, self._schema),
        )
        self.first = mesh.make_mesh()
        is_animated = any(transform.getNumSamples() > 1 for transform in self._transforms)
        return [*notes, *describe_transform(matrix, is_animated), *mesh.notes]

    def _choose_sampling(self) -> tuple[Sampling, list[str]]:
        """Return the times of the points, or of the transforms if the points do not move."""
        times = _sample_times(self._points)
        if len(times) < 2:
            times = set().union(*map(_sample_times, self._transforms), times)
        sampling = Sampling.from_times(times)
        note = f"its {len(times)} samples are not evenly spaced in time; each is used as one frame"
        return sampling, [note] if sampling.is_uneven else []

    def _read_points(self, time: float) -> Floats:
        index = self._points.getTimeSampling().getNearIndex(time, self._points.getNumSamples())
        points = np.array(read_sample(self._points, index), np.float32)
        return transform_points(points.reshape(-1, 3), self._world_matrix(time))

    def _world_matrix(self, time: float) -> Floats:
        matrix = np.eye(4)
        for transform in self._transforms:
            matrix = matrix @ _interpolate_matrix(transform, time)
        return matrix

    def _read_polygons(self) -> Polygons:
        """Read the faces, which must never change."""
        properties = (self._schema.getFaceCountsProperty(), self._schema.getFaceIndicesProperty())
        samples = range(max(1 if p.isConstant() else p.getNumSamples() for p in properties))
        return read_constant_polygons(partial(_read_polygons_at, properties), samples)


def _check_header(path: Path) -> None:
    """Refuse files that the library would open as an empty archive, or not at all."""
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


@contextmanager
def _wrap_alembic_errors() -> Iterator[None]:
    """Turn what Alembic raises inside into a FormatError."""
    try:
        yield
    except (RuntimeError, IndexError, UnicodeDecodeError) as error:
        # Exceptions are wrapped in one another; the innermost names the cause.
        cause = " ".join(str(error).rpartition("EXCEPTION:")[2].split())
        raise FormatError(f"is not a sound Alembic file ({cause}); export it again") from error


def _iterate_descendants(thing: Any) -> Iterator[Any]:
    for child in thing.children:
        yield child
        yield from _iterate_descendants(child)


def _find_transforms(thing: Any) -> list[Any]:
    """Return the transforms that move an object, its own first."""
    from alembic3d.Abc import WrapExistingFlag
    from alembic3d.AbcGeom import IXform

    found = []
    while thing.getParent().valid():
        if IXform.matches(thing.getHeader()):
            found.append(IXform(thing, WrapExistingFlag.kWrapExisting).getSchema())
            if not found[-1].getInheritsXforms():
                break
        thing = thing.getParent()
    return found


def _sample_times(sampled: Any) -> set[float]:
    """Return the times of the samples, if there are several."""
    count = sampled.getNumSamples()
    sampling = sampled.getTimeSampling()
    return {sampling.getSampleTime(k) for k in range(count)} if count > 1 else set()


def _interpolate_matrix(transform: Any, time: float) -> Floats:
    """Return a transform at a time, interpolated linearly between two samples."""
    from alembic3d.Abc import ISampleSelector

    count, sampling = transform.getNumSamples(), transform.getTimeSampling()
    if count == 0:
        return np.eye(4)
    # By their times: a selector would take an index for seconds, too.
    start, stop = (
        sampling.getSampleTime(find(time, count))
        for find in (sampling.getFloorIndex, sampling.getCeilIndex)
    )
    before, after = (
        np.array([list(row) for row in transform.getValue(ISampleSelector(at)).getMatrix()])
        for at in (start, stop)
    )
    part = (time - start) / (stop - start) if stop > start else 0.0
    return np.asarray(before + min(max(part, 0.0), 1.0) * (after - before))


def _read_polygons_at(properties: tuple[Any, Any], sample: int) -> Polygons:
    counts, corners = (read_sample(p, min(sample, p.getNumSamples() - 1)) for p in properties)
    return Polygons(np.array(counts, np.int64), np.array(corners, np.int64))


def _read_frame_rate(archive: Any, mesh: Any) -> float | None:
    """Return the frames per second that cageik or another program states; None if none does."""
    from alembic3d.Abc import GetArchiveInfo

    stated = (mesh.getMetaData().get(FPS_KEY), GetArchiveInfo(archive).get("dccFPS"))
    for value in stated:
        try:
            fps = float(value or 0)
        except ValueError:
            continue
        if 0 < fps < float("inf"):
            return fps
    return None


def _make_scene_hints(sampling: Sampling, fps: float | None) -> SceneHints:
    """Return frame rate and numbers of samples; those at `fps` if samples are whole frames of it.

    Alembic knows seconds only. Without a rate, the step is the smallest that makes the number of
    the first frame whole.
    """
    if sampling.step is None:
        return SceneHints()
    seconds = float(sampling.times[0])
    step = round_frame_step(sampling.step * fps) if fps is not None else None
    if fps is None or (step is not None and step != int(step)):
        fps = frames_per_second(sampling.step)
        step = find_frame_step(seconds * fps, START_TOL)
        fps *= step or 1
    return SceneHints(fps=fps, start=round(seconds * fps, 6), frame_step=step)


class Writer(AnimationWriter):
    """Each frame at its number / fps seconds of the mesh `/NAME`; faces turn clockwise there."""

    suffixes = (".abc",)
    is_single = True

    @classmethod
    def require_libraries(cls) -> None:
        """Raise MissingLibraryError without alembic3d."""
        with require_optional("alembic3d", "abc", "writing .abc"):
            import alembic3d  # noqa: F401

    def __init__(self, target: Path, animation: Animation) -> None:
        with require_optional("alembic3d", "abc", "writing .abc"):
            from alembic3d.Abc import OArchive
            from alembic3d.AbcCoreAbstract import MetaData, TimeSampling
            from alembic3d.AbcGeom import OPolyMesh

        _check_disk_space(target, animation)
        scene, self._surface = animation.scene, AlembicSurface(animation.rest)
        try:
            # With a name of the program, the archive would hold the time, too.
            archive = OArchive(str(target))
            step, start = scene.frame_step / scene.fps, scene.start / scene.fps
            times = archive.addTimeSampling(TimeSampling(step, start))
            stated = MetaData()
            stated.set(FPS_KEY, f"{scene.fps:.12g}")
            mesh = OPolyMesh(archive.getTop(), animation.name, stated, times)
        except RuntimeError as error:
            raise OSError(str(error)) from error
        # The last reference to the file: it is closed with this.
        self._schema = mesh.getSchema()

    def append(self, frames: Floats) -> None:
        """Write the next frames."""
        for positions in frames:
            self._schema.set(self._surface.make_sample(positions))

    def complete(self) -> None:
        """Write what is of all frames, and close the file."""
        self._surface.write_face_sets(self._schema)
        del self._schema

    def abandon(self) -> None:
        """Close the file."""
        self.__dict__.pop("_schema", None)


def _check_disk_space(target: Path, animation: Animation) -> None:
    """Refuse what does not fit: Alembic ends the process when its last write fails."""
    rest = animation.rest
    corners = 0 if rest.attributes is None else len(rest.attributes.corners)
    size = 12 * animation.frame_count * (len(rest.vertices) + corners) + 16 * len(rest.faces)
    size += ARCHIVE_BYTES
    if size > shutil.disk_usage(target.parent).free:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
