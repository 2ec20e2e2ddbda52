"""Alembic in and out: polygon meshes, below transforms, that have samples in time.

UVs, normals and materials are those of the first sample; other programs know materials as face
sets.
"""

import errno
import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import accumulate
from math import ceil, floor
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.files import ClaimedBytes, require_unicode
from cageik_cli.formats.base.mesh_data import LayerReaders, list_layer_readers
from cageik_cli.formats.base.scene_graph import (
    EVEN_STEP_TOL,
    LibraryError,
    Polygons,
    SceneMesh,
    SceneReader,
    blend_transforms,
    round_frame_step,
    sample_evenly,
)
from cageik_cli.formats.base.writers import SHAPE_SUFFIX, Animation, AnimationWriter, to_float32
from cageik_cli.formats.settings import Scene, SceneHints, find_frame_step
from cageik_cli.geometry.attributes import LAYERS, FaceLabels, SurfaceAttributes
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import compute_corner_normals
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import (
    ConnectivityError,
    FileAccessError,
    FormatError,
    require_optional,
)
from cageik_cli.util.files import open_input
from cageik_cli.util.messages import Note, Said, say
from cageik_cli.util.text import single_line

PARAMETERS = {"uvs": "getUVsParam", "normal_fans": "getNormalsParam"}
"""What returns the parameter of a mesh that holds a layer of numbers."""

FPS_KEY = "cageik_fps"
"""Where a mesh states the frame rate. The archive could only state it together with the time."""

MAX_BAKED_STEP = 0.1
"""Seconds between samples of transforms: longer steps are between keys if no rate is stated."""

MAX_KEYED_FRAMES = 100_000
"""Frames that transforms with few keys are sampled at, at most."""

SAME_TIME_TOL = 1e-6
"""Times that differ by less than this share of a step are one: seconds of other rates round."""


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
        self._transforms = _find_transforms(thing)

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
            matrix = matrix @ _interpolate_matrix(transform, time)
        return matrix

    def has_moving_transform(self) -> bool:
        """Return whether a transform has several samples."""
        return any(transform.getNumSamples() > 1 for transform in self._transforms)

    def read_points(self, time: float) -> np.ndarray:
        """Read the points at a time, interpolated linearly between two samples."""
        start, stop, part = _locate_samples(self._points, time)
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


def require_alembic(purpose: str) -> None:
    """Raise MissingLibraryError without alembic3d, which is needed for a purpose."""
    with require_optional("alembic3d", purpose):
        import alembic3d  # noqa: F401


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
            archive = OArchive(require_unicode(target))
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
            tree = _TransformTree(archive.getTop(), matrices)
            # The last references to the file: it is closed with these.
            self._meshes = []
            for (above, _, name), part in zip(places, parts, strict=True):
                schema = OPolyMesh(tree.define(above), name, stated, times).getSchema()
                self._meshes.append((schema, _AlembicSurface(part.own_mesh), part))
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


class _AlembicSurface:
    """The faces of a mesh as Alembic has them, clockwise, with their UVs and normals."""

    def __init__(self, mesh: TriMesh) -> None:
        from alembic3d.AbcGeom import GeometryScope, OV2fGeomParamSample
        from imath import IntArrayFromBuffer, UnsignedIntArray, V2fArrayFromBuffer

        self._attributes = attributes = mesh.polygons.reverse(keeps_first=False)
        self._faces = tuple(
            IntArrayFromBuffer(np.ascontiguousarray(part, np.int32))
            for part in (attributes.corners, attributes.corner_counts)
        )
        self._uvs = None
        if attributes.uvs is not None:  # of corners; those without are at zero
            values, indices = attributes.uvs.complete()
            numbers = UnsignedIntArray(len(indices))
            for place, index in enumerate(indices.tolist()):
                numbers[place] = index
            table = V2fArrayFromBuffer(to_float32(values))
            self._uvs = OV2fGeomParamSample(table, numbers, GeometryScope.kFacevaryingScope)

    def make_sample(self, positions: Floats) -> Any:
        """Return the sample of a frame, (m, 3)."""
        from alembic3d.AbcGeom import (
            GeometryScope,
            ON3fGeomParamSample,
            OPolyMeshSchemaSample,
            OV2fGeomParamSample,
        )
        from imath import V3fArrayFromBuffer

        points = V3fArrayFromBuffer(to_float32(positions))
        attributes = self._attributes
        if attributes.normal_fans is None and self._uvs is None:
            return OPolyMeshSchemaSample(points, *self._faces)
        uvs = self._uvs or OV2fGeomParamSample()
        if attributes.normal_fans is None:
            return OPolyMeshSchemaSample(points, *self._faces, uvs)
        # Of faces that are turned, they point inward.
        normals = V3fArrayFromBuffer(to_float32(-compute_corner_normals(attributes, positions)))
        sample = ON3fGeomParamSample(normals, GeometryScope.kFacevaryingScope)
        return OPolyMeshSchemaSample(points, *self._faces, uvs, sample)

    def write_face_sets(self, schema: Any) -> None:
        """Write a face set for each material, which other programs take as such."""
        from alembic3d.AbcGeom import OFaceSetSchemaSample
        from imath import IntArrayFromBuffer

        labels = self._attributes.materials
        taken: set[str] = set()
        for name, polygons in labels.list_members() if labels is not None else ():
            name = name.replace("/", "_")  # a slash would be a path
            while name in taken:
                name += "_"
            taken.add(name)
            faces = IntArrayFromBuffer(np.ascontiguousarray(polygons, np.int32))
            schema.createFaceSet(name).getSchema().set(OFaceSetSchemaSample(faces))


def place_meshes(parts: Sequence[str], are_still: Sequence[bool]) -> list[str]:
    """Return the paths of the meshes of parts, which are at these paths.

    Programs call an object by the transform above its mesh. So a part is a transform of its name
    with the mesh below, unless it is alone below a transform whose name its own begins with, as
    in archives of such programs. A part at the top that nothing moves has no transform.
    """
    folders = [path.rpartition("/")[0] for path in parts]
    crowd = Counter(folders)
    uppers = {upper for path in parts for upper in accumulate(path.split("/")[:-1], "{}/{}".format)}
    taken, placed = set(parts), []
    for path, folder, is_still in zip(parts, folders, are_still, strict=True):
        name, above = path.rpartition("/")[2], folder.rpartition("/")[2]
        is_shape = crowd[folder] == 1 and name.startswith(above) and folder not in taken
        if path not in uppers and (is_shape if folder else is_still):
            placed.append(path)
        else:
            placed.append(f"{path}/{name}{SHAPE_SUFFIX}")
    return placed


def name_parts(meshes: Sequence[str], are_still: Sequence[bool]) -> list[str]:
    """Return the paths of parts whose meshes are at these paths.

    A mesh `NAME/NAMEShape` is the part `NAME`, where `place_meshes` puts that part there again.
    """
    parts = list(meshes)
    for k, path in enumerate(meshes):
        folder = path.rpartition("/")[0]
        if folder and path == f"{folder}/{folder.rpartition('/')[2]}{SHAPE_SUFFIX}":
            parts[k] = folder
    while True:
        placed, counts = place_meshes(parts, are_still), Counter(parts)
        lost = [
            k
            for k, path in enumerate(meshes)
            if parts[k] != path and (placed[k] != path or counts[parts[k]] > 1)
        ]
        if not lost:
            return parts
        for k in lost:
            parts[k] = meshes[k]


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


def _locate_samples(sampled: Any, time: float) -> tuple[int, int, float]:
    """Return the samples before and after a time, and the part of the way between them.

    At a sample, to rounding of its time, they are the same.
    """
    count, sampling = sampled.getNumSamples(), sampled.getTimeSampling()
    start, stop = sampling.getFloorIndex(time, count), sampling.getCeilIndex(time, count)
    begin, end = sampling.getSampleTime(start), sampling.getSampleTime(stop)
    part = (time - begin) / (end - begin) if end > begin else 0.0
    if part < SAME_TIME_TOL:
        return start, start, 0.0
    return (stop, stop, 0.0) if part > 1 - SAME_TIME_TOL else (start, stop, part)


def _interpolate_matrix(transform: Any, time: float) -> Floats:
    """Return a transform at a time between two samples.

    Its operations, such as a rotation by an angle, are interpolated linearly, as programs do.
    Matrices are taken apart for that: a turn stays a turn.
    """
    from alembic3d.Abc import ISampleSelector

    if transform.getNumSamples() == 0:
        return np.eye(4)
    start, stop, part = _locate_samples(transform, time)
    before, after = (
        # By its time: a selector would take an index for seconds, too.
        transform.getValue(ISampleSelector(at))
        for at in map(transform.getTimeSampling().getSampleTime, (start, stop))
    )
    if part == 0:
        return _to_matrix(before)
    operations = [each.getOp(k) for each in (before, after) for k in range(each.getNumOps())]
    if before.isTopologyEqual(after) and not any(each.isMatrixOp() for each in operations):
        return _blend_operations(before, after, part)
    return blend_transforms(_to_matrix(before), _to_matrix(after), part)


def _to_matrix(sample: Any) -> Floats:
    return np.array([list(row) for row in sample.getMatrix()])


def _blend_operations(before: Any, after: Any, part: float) -> Floats:
    """Return the matrix of a sample between two that have the same operations."""
    from alembic3d.AbcGeom import XformSample

    blend = XformSample()
    for k in range(before.getNumOps()):
        operation, other = before.getOp(k), after.getOp(k)
        for channel in range(operation.getNumChannels()):
            start, stop = (each.getChannelValue(channel) for each in (operation, other))
            operation.setChannelValue(channel, start + part * (stop - start))
        blend.addOp(operation)
    return _to_matrix(blend)


def is_still(thing: Any) -> bool:
    """Return whether no transform places an object, at second 0."""
    moves = [_interpolate_matrix(each, 0.0) for each in _find_transforms(thing)]
    return all(np.array_equal(matrix, np.eye(4)) for matrix in moves)


class _TransformTree:
    """The transforms above meshes, which are written as they are needed.

    Parameters
    ----------
    top : OObject
        The top of the archive.
    matrices : dict
        The transforms (4, 4) into the scene that some of them have, by their paths.
    """

    def __init__(self, top: Any, matrices: dict[str, Floats]) -> None:
        self._objects: dict[str, Any] = {"": top}
        self._matrices = {**matrices, "": np.eye(4)}

    def define(self, path: str) -> Any:
        """Return the transform at a path; those above it are written first."""
        if path not in self._objects:
            import imath
            from alembic3d.AbcGeom import OXform, XformSample

            above, _, name = path.rpartition("/")
            parent = self.define(above)
            matrix = self._matrices.setdefault(path, self._matrices[above])
            local = matrix @ np.linalg.inv(self._matrices[above])
            transform = OXform(parent, name)
            if not np.array_equal(local, np.eye(4)):
                sample = XformSample()
                sample.setMatrix(imath.M44d(*local.ravel().tolist()))
                transform.getSchema().set(sample)
            self._objects[path] = transform
        return self._objects[path]
