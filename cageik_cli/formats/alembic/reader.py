"""A clip in Alembic: meshes whose points or transforms have samples, and their surfaces."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from math import ceil, floor
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.alembic.library import FPS_KEY, require_alembic
from cageik_cli.formats.alembic.paths import name_parts
from cageik_cli.formats.alembic.transforms import (
    SAME_TIME_TOL,
    find_transforms,
    interpolate_matrix,
    is_still,
    locate_samples,
)
from cageik_cli.formats.base.files import ClaimedBytes, require_unicode
from cageik_cli.formats.base.mesh_data import LayerReaders, list_layer_readers
from cageik_cli.formats.base.scene_graph import (
    EVEN_STEP_TOL,
    LibraryError,
    Polygons,
    SceneMesh,
    SceneReader,
    round_frame_step,
    sample_evenly,
)
from cageik_cli.formats.settings import Scene, SceneHints, find_frame_step
from cageik_cli.geometry.attributes import LAYERS, FaceLabels, SurfaceAttributes
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import ConnectivityError, FileAccessError, FormatError
from cageik_cli.util.files import open_input
from cageik_cli.util.messages import Note, Said, say
from cageik_cli.util.text import single_line

PARAMETERS = {"uvs": "getUVsParam", "normal_fans": "getNormalsParam"}
"""What returns the parameter of a mesh that holds a layer of numbers."""

MAX_BAKED_STEP = 0.1
"""Seconds between samples of transforms: longer steps are between keys if no rate is stated."""

MAX_KEYED_FRAMES = 100_000
"""Frames that transforms with few keys are sampled at, at most."""


class Reader(SceneReader):
    """Frames of the polygon meshes of an archive; times are seconds."""

    suffixes = (".abc",)
    library = "alembic3d"

    def check_file(self, path: Path) -> None:
        """Refuse what the library would open as an empty archive, or not at all."""
        require_alembic("reading .abc")
        with open_input(path) as stream:
            try:
                header = stream.read(16)
            except OSError as error:
                raise FileAccessError(f"cannot be read: {error.strerror or error}") from error
        if header.startswith(b"\x89HDF"):
            raise FormatError(
                "is an old Alembic file, in HDF5; convert it with abcconvert -toOgawa"
            )
        if not header.startswith(b"Ogawa"):
            raise FormatError("is not an Alembic file; export it again")
        # A byte that is set when the file is closed, and the place of its root, at the end.
        if header[5:6] != b"\xff" or int.from_bytes(header[8:], "little") >= path.stat().st_size:
            raise FormatError(
                "is cut short, or was not closed by the program that wrote it; export it again"
            )
        self._lock = Lock()  # the library's streams are not thread-safe

    @contextmanager
    def guard(self) -> Iterator[list[Said]]:
        """Convert errors; one thread at a time."""
        try:
            with self._lock:
                yield []
        except (RuntimeError, IndexError, UnicodeDecodeError) as error:
            cause = _find_cause(error)
            raise LibraryError(f"is not a sound Alembic file ({cause}); export it again") from error

    def list_meshes(self, path: Path) -> tuple[dict[str, Any], dict[str, str]]:
        """Open the archive."""
        from alembic3d.Abc import IArchive, ISampleSelector
        from alembic3d.AbcGeom import IPolyMesh, IsAncestorInvisible

        self._archive, self._claimed = (
            IArchive(require_unicode(path)),
            ClaimedBytes(path.stat().st_size),
        )
        self._stated_rates: list[str] = []
        objects = _iterate_descendants(self._archive.getTop())
        meshes = [thing for thing in objects if IPolyMesh.matches(thing.getHeader())]
        paths = [thing.getFullName() for thing in meshes]
        names = name_parts(paths, [is_still(thing) for thing in meshes])
        self._names = dict(zip(paths, names, strict=True))
        found, first = dict(zip(names, meshes, strict=True)), ISampleSelector(0)
        hidden = [name for name, thing in found.items() if IsAncestorInvisible(thing, first)]
        return found, dict.fromkeys(hidden, "invisible")

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

    def sample_keys(
        self, times: Floats, step: float | None, fps: float | None
    ) -> tuple[Floats, Note] | None:
        """Return the times of frames at the archive's rate where transforms have few keys.

        It is that which is asked for, else that which is stated. Without a stated one, steps above
        `MAX_BAKED_STEP` are between keys.
        """
        stated = _read_frame_rate(self._archive, self._stated_rates)
        baked = MAX_BAKED_STEP if stated is None else 1 / stated
        if not self.has_keyed_motion() or (
            step is not None and step <= baked * (1 + EVEN_STEP_TOL)
        ):
            return None
        rate = fps or stated or Scene().fps
        first, last = ceil(times[0] * rate - EVEN_STEP_TOL), floor(times[-1] * rate + EVEN_STEP_TOL)
        if last <= first:
            return None
        found = f"its transforms have {len(times)} keys from {times[0]:g} to {times[-1]:g} s"
        frames = sample_evenly(first, last, 1, MAX_KEYED_FRAMES) / rate
        if fps or stated:
            return frames, Note(f"{found}: frames are {rate:g} per second")
        text = f"{found}, and it states no rate: frames are {rate:g} per second; "
        return frames, Note(text + say("`fps=` takes another rate"), "warning")

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

    def list_point_times(self) -> set[float]:
        """List the times of the points."""
        return _sample_times(self._points)

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
            np.array(_read_sample(self._points, index, self._claimed.packed), np.float32).reshape(
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
            np.array(_read_sample(p, min(int(time), p.getNumSamples() - 1), size), np.int64)
            for p in self._polygon_properties
        )
        self._claimed.claim(4 * (len(counts) + len(corners)))
        return counts, corners

    @property
    def _polygon_properties(self) -> tuple[Any, Any]:
        return self._schema.getFaceCountsProperty(), self._schema.getFaceIndicesProperty()

    def list_surface_layers(self, vertex_count: int, time: float) -> LayerReaders:
        """Return what reads UVs, normals and face sets, in the first sample."""
        self._claimed.claim(12 * vertex_count)
        readers = list_layer_readers(PARAMETERS, self._read_parameter)
        readers["its face sets"] = self._read_face_sets
        return {noun: partial(_read_safely, read) for noun, read in readers.items()}

    def _read_parameter(self, name: str, attributes: SurfaceAttributes) -> SurfaceAttributes:
        """Read the values of corners, or of vertices, that a parameter holds."""
        parameter = getattr(self._schema, PARAMETERS[name])()
        if not parameter.valid() or not parameter.getNumSamples():
            return attributes
        values = self._read_first(parameter.getValueProperty(), np.float64)
        values = values.reshape(-1, LAYERS[name].width)
        if name == "normal_fans" and not np.isfinite(values).all():
            raise FormatError("they are not finite")
        return attributes.add_layer(name, values, self._locate(parameter, attributes, len(values)))

    def _read_face_sets(self, attributes: SurfaceAttributes) -> SurfaceAttributes:
        """Read the face sets as materials, as other programs do."""
        count, sets = len(attributes.corner_counts), []
        for name in self._schema.getFaceSetNames():
            sampled = self._schema.getFaceSet(name).getSchema().getFacesProperty()
            if not sampled.getNumSamples():
                continue
            faces = self._read_first(sampled, np.int64)
            if len(faces) and not 0 <= faces.min() <= faces.max() < count:
                raise FormatError(f"`{name}` names faces that are not there")
            sets.append((single_line(name), faces))
        return replace(attributes, materials=FaceLabels.from_members(count, sets))

    def _read_first(self, sampled: Any, kind: type[np.float64 | np.int64]) -> NDArray[Any]:
        values = _read_sample(sampled, 0, self._claimed.packed)
        self._claimed.claim(len(values) * sampled.getDataType().getNumBytes())
        with np.errstate(invalid="ignore"):  # a signalling nan is refused with the others
            return np.array(values, kind)

    def _locate(self, parameter: Any, attributes: SurfaceAttributes, count: int) -> Integers:
        """Return the place of the value of each corner among `count` values."""
        from alembic3d.AbcGeom import GeometryScope

        scope, places = parameter.getScope(), np.arange(count)
        if parameter.isIndexed():
            places = self._read_first(parameter.getIndexProperty(), np.int64)
        if scope in (GeometryScope.kVertexScope, GeometryScope.kVaryingScope):
            corners = attributes.corners
        elif scope == GeometryScope.kFacevaryingScope:
            corners = np.arange(len(attributes.corners))
        else:
            raise FormatError("they are not those of corners or vertices")
        if corners.max(initial=-1) >= len(places):
            raise FormatError(f"{len(places)} values, expected {corners.max() + 1}")
        found = places[corners]
        if len(found) and not 0 <= found.min() <= found.max() < count:
            raise FormatError(f"they name value {found.max()} of {count}")
        return np.asarray(found, np.int64)


def _iterate_descendants(thing: Any) -> Iterator[Any]:
    for child in thing.children:
        yield child
        yield from _iterate_descendants(child)


def _sample_times(sampled: Any) -> set[float]:
    """Return the times of the samples, if there are several."""
    count = sampled.getNumSamples()
    sampling = sampled.getTimeSampling()
    return {sampling.getSampleTime(k) for k in range(count)} if count > 1 else set()


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


def _read_safely(
    read: Callable[[SurfaceAttributes], SurfaceAttributes], attributes: SurfaceAttributes
) -> SurfaceAttributes:
    """Turn what the library raises while a part is read into a FormatError."""
    try:
        return read(attributes)
    except (FormatError, RuntimeError, IndexError, TypeError, ValueError) as error:
        raise FormatError(single_line(_find_cause(error))) from error


def _find_cause(error: Exception) -> str:
    """Return what the innermost of exceptions says that are wrapped in one another."""
    return " ".join(str(error).rpartition("EXCEPTION:")[2].split())


def _read_sample(sampled: Any, index: int, size: int) -> Any:
    """Read one array of a file of some size.

    A missing one, which has no digest, would crash the library.
    """
    name = f"sample {index} of `{sampled.getName()}`"
    if not sampled.getKey(index):
        raise FormatError(f"{name} is missing; export it again")
    needed = sampled.getDimension(index).numPoints() * sampled.getDataType().getNumBytes()
    if needed > size:
        raise FormatError(f"{name} takes {needed} bytes of a file of {size}; export it again")
    return sampled.getValue(index)
