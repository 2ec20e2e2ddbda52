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
from cageik_cli.formats.base.mesh_data import Change, LayerReaders, list_layer_readers
from cageik_cli.formats.base.scene_graph import (
    EVEN_STEP_TOL,
    MAX_KEYED_SHAPES,
    LibraryError,
    Polygons,
    SceneMesh,
    SceneReader,
    find_step,
    round_frame_step,
    sample_evenly,
    snap,
    snap_rate,
)
from cageik_cli.formats.base.sequence import ClipRequest
from cageik_cli.formats.settings import Scene, SceneHints, find_frame_step
from cageik_cli.geometry.attributes import LAYERS, FaceLabels, Subdivision, SurfaceAttributes
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import ConnectivityError, FileAccessError, FormatError
from cageik_cli.util.files import open_content
from cageik_cli.util.messages import Note, Said, say
from cageik_cli.util.text import group_digits, single_line

PARAMETERS = {"uvs": "getUVsParam", "normal_fans": "getNormalsParam"}
"""What returns the parameter of a mesh that holds a layer of numbers."""

SCHEMES = {"": "catmullClark", "catmull-clark": "catmullClark"}
"""Subdivision schemes of Alembic that USD, whose words we keep, calls otherwise."""

SCOPES = {
    "kVertexScope": "vertex",
    "kVaryingScope": "vertex",
    "kFacevaryingScope": "corner",
    "kUniformScope": "face",
}
"""What has one value of a parameter, by the scope that is stated."""

MAX_BAKED_STEP = 0.1
"""Seconds between samples of transforms: longer steps are between keys if no rate is stated."""

MAX_KEYED_FRAMES = 100_000
"""Frames that transforms with few keys are sampled at, at most."""


class Reader(SceneReader):
    """Frames of the polygon meshes of an archive; times are seconds."""

    suffixes = (".abc",)
    library = "alembic3d"

    def __init__(self, request: ClipRequest) -> None:
        self._sampled_rate: float | None = None
        super().__init__(request)
        if self._sampled_rate is not None:
            self._reading += (self._sampled_rate,)

    def check_file(self, path: Path) -> None:
        """Refuse what the library would open as an empty archive, or not at all."""
        require_alembic("reading .abc")
        with open_content(path) as stream:
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
        from alembic3d.AbcGeom import (
            ICurves,
            INuPatch,
            IPoints,
            IPolyMesh,
            IsAncestorInvisible,
            ISubD,
        )

        self._archive = IArchive(require_unicode(path))
        self.claimed = ClaimedBytes(path.stat().st_size)
        self._stated_rates: list[str] = []
        objects, first = list(_iterate_descendants(self._archive.getTop())), ISampleSelector(0)
        meshes = [thing for thing in objects if _is_any(thing, IPolyMesh, ISubD)]
        kinds = {"Curves": ICurves, "NuPatch": INuPatch, "Points": IPoints}
        self.others = {
            thing.getFullName(): name
            for thing in objects
            for name, kind in kinds.items()
            if _is_any(thing, kind) and not IsAncestorInvisible(thing, first)
        }
        paths = [thing.getFullName() for thing in meshes]
        names = name_parts(paths, [is_still(thing) for thing in meshes])
        self._names = dict(zip(paths, names, strict=True))
        found = dict(zip(names, meshes, strict=True))
        hidden = [name for name, thing in found.items() if IsAncestorInvisible(thing, first)]
        return found, dict.fromkeys(hidden, "invisible")

    def find_top(self, member: str | None) -> str | None:
        """Return the part of a mesh that is named by its own path."""
        return self._names.get(member, member) if member else member

    def open_mesh(self, found: Any) -> "AlembicMesh":
        """Open an object."""
        self._stated_rates.append(found.getMetaData().get(FPS_KEY))
        return AlembicMesh(found, self.claimed)

    def is_empty(self, found: Any) -> bool:
        """Return whether an object has no points or no faces in any sample."""
        schema = _open_schema(found)
        return any(
            not any(held.getDimension(k).numPoints() for k in range(held.getNumSamples()))
            for held in (schema.getPositionsProperty(), schema.getFaceCountsProperty())
        )

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
        self._sampled_rate = rate
        if fps or stated:
            return frames, Note(f"{found}: frames are {rate:g} per second")
        text = f"{found}, and it states no rate: frames are {rate:g} per second; "
        return frames, Note(text + say("`fps=` takes another rate"), "warning")

    def replace_uneven(self, times: Floats) -> tuple[Floats, str]:
        """Return times in the steps of baked points, beside which transforms have other keys."""
        counted = [mesh.list_point_times() for mesh in self._meshes.values()]
        baked = np.array(sorted(set().union(*(x for x in counted if len(x) > MAX_KEYED_SHAPES))))
        own = find_step(baked)
        if own is None or times[-1] - times[0] > MAX_KEYED_FRAMES * own:
            return super().replace_uneven(times)
        first = ceil((times[0] - baked[0]) / own - EVEN_STEP_TOL)
        last = floor((times[-1] - baked[0]) / own + EVEN_STEP_TOL)
        return baked[0] + own * np.arange(first, last + 1), (
            f"its transforms have keys beside the {len(baked)} samples of its points: frames are "
            "in the steps of these"
        )

    def describe_scene(self, times: Floats, step: float | None) -> SceneHints:
        """Return frame rate and frame numbers, of whole frames if a rate is stated.

        Alembic knows seconds only. Without a rate, the step is the smallest that makes the number
        of the first frame whole, to 1e-4 frames. The rate of sampled keys is that of their frames.
        """
        if step is None:
            return SceneHints()
        fps = self._sampled_rate or _read_frame_rate(self._archive, self._stated_rates)
        seconds = float(times[0])
        frame_step = round_frame_step(step * fps) if fps is not None else None
        if fps is None or (frame_step is not None and frame_step != int(frame_step)):
            fps = snap_rate(round(1 / step, 9))  # without the digits of rounding errors
            frame_step = find_frame_step(seconds * fps, tolerance=1e-4)
            fps *= frame_step or 1
        return SceneHints(fps=fps, start=snap(seconds * fps), frame_step=frame_step)


class AlembicMesh(SceneMesh):
    """A polygon mesh, or the polygons of a subdivision surface; times are seconds."""

    is_clockwise = True  # in all files

    def __init__(self, thing: Any, claimed: ClaimedBytes) -> None:
        from alembic3d.AbcGeom import ISubD

        self._is_subdivided = _is_any(thing, ISubD)
        self._schema = _open_schema(thing)
        self._vertex_count, self._misstated = 0, list[str | Change]()
        self._claimed = claimed.distinguish(_find_source(thing))
        self._points = self._schema.getPositionsProperty()
        self._transforms = find_transforms(thing)

    def list_times(self) -> set[float]:
        """List the times of the points, and those of the transforms if points are not baked."""
        times = _sample_times(self._points)
        if len(times) <= MAX_KEYED_SHAPES:
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
                f"{group_digits(len(after))} vertices in sample {stop}, expected "
                f"{group_digits(len(before))} as in sample "
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
        self._vertex_count = vertex_count
        held = {name: get for name, get in PARAMETERS.items() if hasattr(self._schema, get)}
        readers = list_layer_readers(held, self._read_parameter)
        readers["its face sets"] = self._read_face_sets
        if self._is_subdivided:
            readers["its subdivision"] = self._read_subdivision
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

    def _read_subdivision(self, attributes: SurfaceAttributes) -> SurfaceAttributes:
        """Read the scheme, the creases and the sharp vertices."""
        schema = self._schema
        stated = schema.getSubdivisionSchemeProperty()
        scheme = str(stated.getValue()) if stated.valid() and stated.getNumSamples() else ""

        def read(held: Any, kind: type[np.float64 | np.int64]) -> NDArray[Any]:
            is_there = held.valid() and held.getNumSamples()
            return self._read_first(held, kind) if is_there else np.zeros(0, kind)

        creases = read(schema.getCreaseIndicesProperty(), np.int64)
        lengths = read(schema.getCreaseLengthsProperty(), np.int64)
        sharpness = read(schema.getCreaseSharpnessesProperty(), np.float64)
        corners = read(schema.getCornerIndicesProperty(), np.int64)
        sharp = read(schema.getCornerSharpnessesProperty(), np.float64)
        named = np.concatenate([creases, corners])
        if named.max(initial=-1) >= self._vertex_count:
            raise FormatError(f"it names vertex {named.max()} of {self._vertex_count}")
        known = SCHEMES.get(scheme, scheme)
        subdivision = Subdivision(known, creases, lengths, sharpness, corners, sharp)
        return replace(attributes, subdivision=subdivision)

    def _read_first(self, sampled: Any, kind: type[np.float64 | np.int64]) -> NDArray[Any]:
        values = _read_sample(sampled, 0, self._claimed.packed)
        self._claimed.claim(len(values) * sampled.getDataType().getNumBytes())
        with np.errstate(invalid="ignore"):  # a signalling nan is refused with the others
            return np.array(values, kind)

    def _locate(self, parameter: Any, attributes: SurfaceAttributes, count: int) -> Integers:
        """Return the place of the value of each corner among `count` values."""
        scope, places = str(parameter.getScope()), np.arange(count)
        if parameter.isIndexed():
            places = self._read_first(parameter.getIndexProperty(), np.int64)
        owners = self._find_owners(scope, attributes, len(places))
        if owners.max(initial=-1) >= len(places):
            raise FormatError(f"{len(places)} values, expected {owners.max() + 1}")
        found = places[owners]
        if len(found) and not 0 <= found.min() <= found.max() < count:
            raise FormatError(f"they name value {found.max()} of {count}")
        return np.asarray(found, np.int64)

    def _find_owners(self, scope: str, attributes: SurfaceAttributes, count: int) -> Integers:
        """Return which of `count` values each corner has, by the scope that is stated.

        If that has another number of values, the scope is that which has so many, as in other
        readers: some programs state a constant scope for one value per corner.
        """
        corners = len(attributes.corners)
        domains = {
            "corner": (np.arange(corners), corners),
            "vertex": (attributes.corners, self._vertex_count),
            "face": (attributes.corner_polygons, len(attributes.corner_counts)),
        }
        stated = SCOPES.get(scope.rpartition(".")[2])
        if stated is None or domains[stated][1] != count:
            fitting = [name for name, (_, size) in domains.items() if size == count and count > 1]
            if fitting:
                words = (
                    f"{{}} of its surface are stated as {scope.rpartition('.')[2]}, and read as "
                    f"one per {fitting[0]}"
                )
                self._misstated.append(Change(words, "value", count))
                return np.asarray(domains[fitting[0]][0], np.int64)
        if stated is None:
            raise FormatError("they are not those of corners or vertices")
        return np.asarray(domains[stated][0], np.int64)

    def describe_transform(self, time: float) -> list[str | Change]:
        """Return notes on what has moved the mesh, and on layers that are not what they say."""
        return super().describe_transform(time) + self._misstated


def _open_schema(thing: Any) -> Any:
    """Return the schema of a polygon mesh or of a subdivision surface."""
    from alembic3d.Abc import WrapExistingFlag
    from alembic3d.AbcGeom import IPolyMesh, ISubD

    kind = ISubD if _is_any(thing, ISubD) else IPolyMesh
    return kind(thing, WrapExistingFlag.kWrapExisting).getSchema()


def _is_any(thing: Any, *kinds: Any) -> bool:
    """Return whether an object is of one of some kinds."""
    return any(kind.matches(thing.getHeader()) for kind in kinds)


def _find_source(thing: Any) -> str:
    """Return the path of an object in the file: instances have one of what they are copies of."""
    path = ""
    while thing.isInstanceDescendant() and not thing.isInstanceRoot():
        path = f"/{thing.getName()}{path}"
        thing = thing.getParent()
    return str(thing.instanceSourcePath() or thing.getFullName()) + path


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
            return snap_rate(fps)
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
