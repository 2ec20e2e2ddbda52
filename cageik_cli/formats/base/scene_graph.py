"""Meshes in scenes: polygons of either winding, moved by transforms, sampled in time."""

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import cached_property
from importlib import import_module
from itertools import chain, takewhile
from math import floor
from pathlib import Path
from time import process_time
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.choose_parts import choose_parts
from cageik_cli.formats.base.files import PART_BYTES, ClaimedBytes, hash_file
from cageik_cli.formats.base.mesh_data import (
    Change,
    FileMesh,
    LayerReaders,
    describe_cut,
    describe_folded,
)
from cageik_cli.formats.base.readers import ClipFile
from cageik_cli.formats.base.sequence import ClipRequest
from cageik_cli.formats.settings import ClipSettings, SceneHints
from cageik_cli.geometry.attributes import make_part_transform
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import join_meshes
from cageik_cli.geometry.rotations import nearest_rotations_by_svd
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import (
    MAX_NAMED,
    ConnectivityError,
    FileAccessError,
    FormatError,
    InputError,
    error_context,
    join_truncated,
)
from cageik_cli.util.files import mark_file
from cageik_cli.util.messages import Note, Said
from cageik_cli.util.text import group_digits
from cageik_cli.util.trial import trials

Polygons = tuple[Integers, Integers]
"""How many corners each face has, (p,), and the vertices of the corners, face after face."""

EVEN_STEP_TOL = 1e-4
"""Steps that differ by more than this fraction of their mean are uneven."""

SNAP_TOL = 1e-4
"""Numbers of frames this near to a whole one, in steps, are that."""

DOUBLE_RATE_TOL = 1e-8
"""Rates nearer to one of video are of double precision, and stay as they are stated."""

MAX_KEYED_SHAPES = 2
"""Points of more samples are baked, and decide when frames are; of two, they are keys."""

MAX_TRIED_SECONDS = 1.0
"""Seconds of a processor that frames behind the first are read for in a trial of their file."""


MAX_MISSING_NAMED = 3
"""Missing files that an error or notes name; others are counted."""


class LibraryError(FormatError):
    """What the library that opens a scene says of it."""


class SceneMesh(ABC):
    """One mesh of a scene, at a time in seconds or in time codes.

    Attributes
    ----------
    is_clockwise : bool
        Whether its faces wind clockwise.
    """

    is_clockwise: bool

    def list_times(self) -> set[float]:
        """List when the points are sampled, or the transforms; nothing if none of them moves."""
        return set()

    def list_point_times(self) -> set[float]:
        """List when the points are sampled; nothing if they do not move in the mesh's space."""
        return set()

    @abstractmethod
    def compute_matrix(self, time: float) -> Floats:
        """Return the transform of the mesh into the scene, (4, 4), which multiplies rows."""

    @abstractmethod
    def has_moving_transform(self) -> bool:
        """Return whether a transform of the mesh has several samples."""

    @abstractmethod
    def read_points(self, time: float) -> NDArray[np.floating]:
        """Read the points in the space of the mesh, (m, 3)."""

    def list_polygon_times(self) -> Sequence[float]:
        """List when faces are sampled, or the numbers of samples; nothing if they never change."""
        return []

    @abstractmethod
    def read_polygons(self, time: float) -> Polygons:
        """Read the faces at one of these times."""

    @abstractmethod
    def list_surface_layers(self, vertex_count: int, time: float) -> LayerReaders:
        """Return what reads the layers of the surface, for `FileMesh.read_layers`."""

    def read_moved(self, time: float) -> Floats:
        """Read the points in the space of the scene, (m, 3)."""
        return transform_points(self.read_points(time), self.compute_matrix(time))

    def read_mesh(self, points: Floats, time: float) -> FileMesh:
        """Return the mesh with these points, in the scene, and its surface at a time."""
        times = self.list_polygon_times() or [time]
        counts, corners = read_constant_polygons(self.read_polygons, times)
        check_corner_counts(counts, corners)
        mesh = FileMesh(points, corners.astype(np.int64), counts.astype(np.int64))
        TriMesh(points, mesh.fans)  # names vertices that are not there
        mesh = mesh.read_layers(self.list_surface_layers(len(points), time))
        is_inside_out = self.is_clockwise != self.is_mirrored(time)
        return mesh.turn_faces() if is_inside_out else mesh

    def is_mirrored(self, time: float) -> bool:
        """Return whether the surface is turned inside out on its way into the scene."""
        return is_mirroring(self.compute_matrix(time))

    def describe_transform(self, time: float) -> list[str | Change]:
        """Return a note on a mesh that its transform has moved."""
        if self.has_moving_transform():
            return ["moved by an animated transform into the scene's space"]
        if not np.array_equal(self.compute_matrix(time), np.eye(4)):
            return ["moved by a transform into the scene's space"]
        return []


class SceneReader(ClipFile):
    """Frames of the meshes of a scene, as parts of one mesh in its space, evaluated on demand.

    Formats open a scene, list its meshes and open each.

    Attributes
    ----------
    claimed : ClaimedBytes
        Counts what is taken of the file; of `list_meshes`.
    lacking : sequence of str
        What the scene refers to and is not there, a sentence each; of `list_meshes`.
    library : str
        What opens the file, and may end the process on a damaged one; nothing where only cageik
        reads it.
    others : mapping
        What is seen and is no mesh: its kind, as the format calls it, by path; of `list_meshes`.
    winding_note : str
        What a user is told of clockwise faces; nothing where all files of the format have them.
    """

    has_members = True
    has_parts = True
    winding_note = ""
    others: Mapping[str, str] = MappingProxyType({})
    library = ""
    claimed: ClaimedBytes
    lacking: Sequence[str] = ()

    def check_file(self, path: Path) -> None:  # some have no library
        """Refuse a file, or a missing library, before the library opens the file."""

    @abstractmethod
    def guard(self) -> AbstractContextManager[list[Said]]:
        """Turn what the library raises inside into a LibraryError; yield warnings at the end."""

    @abstractmethod
    def list_meshes(self, path: Path) -> tuple[dict[str, Any], dict[str, str]]:
        """Open the file, and list its meshes.

        Returns
        -------
        found : dict
            What `open_mesh` opens, by its path, in the order of the file.
        hidden : dict
            Why some of them are not seen, by path: "invisible".
        """

    @abstractmethod
    def open_mesh(self, found: Any) -> SceneMesh:
        """Open one of the meshes that were found."""

    def is_empty(self, found: Any) -> bool:
        """Return whether one of the meshes that were found never has points, or faces."""
        return False

    def find_top(self, member: str | None) -> str | None:
        """Return what the meshes that are read are below, of the text behind `::`."""
        return member

    def list_times(self, meshes: Sequence[SceneMesh]) -> set[float]:
        """List when the meshes that are read are sampled; nothing if none of them moves."""
        return set(chain.from_iterable(mesh.list_times() for mesh in meshes))

    def sample_keys(
        self, times: Floats, step: float | None, fps: float | None
    ) -> tuple[Floats, Note] | None:
        """Return the times of frames where motion has few keys, and a note; else None.

        `step` is as in `describe_scene`; `fps` is the rate that is asked for.
        """
        return None

    def has_keyed_motion(self) -> bool:
        """Return whether transforms or rigs alone move the meshes: points have few samples."""
        is_moved = any(mesh.has_moving_transform() for mesh in self._meshes.values())
        return is_moved and not self._has_baked_points()

    def _has_baked_points(self) -> bool:
        """Return whether points have samples that decide when frames are."""
        counts = [len(mesh.list_point_times()) for mesh in self._meshes.values()]
        return max(counts) > MAX_KEYED_SHAPES

    def replace_uneven(self, times: Floats) -> tuple[Floats, str]:
        """Return the times of frames in place of uneven ones, and a note."""
        note = f"its {len(times)} samples are not evenly spaced in time; each is used as one frame"
        return times, note

    def describe_step(self, step: float | None) -> list[Note]:
        """Return a note on times that are far apart; `step` is as in `describe_scene`."""
        return []

    @abstractmethod
    def describe_scene(self, times: Floats, step: float | None) -> SceneHints:
        """Return what the file says of the scene; `step` is None for one frame, or uneven ones."""

    @property
    def files(self) -> Sequence[Path]:
        """The files that hold the scene, its own first."""
        return [self.path]

    def describe_source(self) -> dict[str, Any]:
        """Return the file's name, how many files hold the scene, and a digest over all."""
        count = len(self.files)
        return super().describe_source() | ({"files": count} if count > 1 else {})

    @cached_property
    def _digest(self) -> bytes:
        digests = [hash_file(file) for file in dict.fromkeys(self.files)]
        return digests[0] if len(digests) == 1 else hashlib.sha256(b"".join(digests)).digest()

    def __init__(self, request: ClipRequest) -> None:
        self.path = path = request.path
        own = mark_file(path)  # before anything is read of it
        with error_context(path):
            self.check_file(path)
            if self.library:
                self.try_first(request, self.library)
            with self.guard() as warnings, trials.silence():
                try:
                    notes = self._open_clip(path, request)
                except InputError as error:
                    if not self.lacking:
                        raise
                    raise FileAccessError(
                        f"{join_truncated(self.lacking, MAX_MISSING_NAMED)}; put what is missing "
                        "there, or correct its path; without it: " + error.text
                    ) from error
        self._marks = {file: mark_file(file) for file in self.files} | {path: own}
        left_out = self.lacking[:MAX_MISSING_NAMED]
        missing = [Note(f"{text}; it is left out", "warning") for text in left_out]
        more = len(self.lacking) - len(missing)
        if more:
            missing.append(Note(f"{more} more that it refers to are not there", "warning"))
        said = (*missing, *notes, *warnings)
        self.notes = tuple(
            Note(each.text, each.kind, path.name)
            if isinstance(each, Note)
            else Note(each, place=path.name)
            for each in said
        )

    def try_first(self, request: ClipRequest, library: str) -> None:
        """Read a file in another process first, where that is wanted; refuse what fails there."""
        fault = trials.find_fault(
            library,
            try_scene,
            type(self).__module__,
            str(request.path),
            request.member,
            request.settings.exclude,
            key=str(mark_file(request.path)),
        )
        if fault:
            raise FormatError(fault)

    def read_positions(self, index: int) -> Floats:
        """Read the vertices of one frame."""
        with error_context(self.location(index)), self.guard():
            points = []
            for name, mesh in self._meshes.items():
                with error_context(name):
                    points.append(mesh.read_moved(self._times[index]))
            parts = self.first.polygons.parts
            assert parts is not None
            for name, own, count in zip(parts.names, points, parts.vertex_counts, strict=True):
                if len(own) != count:
                    raise ConnectivityError(
                        f"{group_digits(len(own))} vertices of {name}, the rest pose has "
                        f"{group_digits(count)}; all must share "
                        "one connectivity"
                    )
            return np.concatenate(points)

    def _open_clip(self, path: Path, request: ClipRequest) -> list[Said | Note]:
        """Find the meshes and their frames; return notes on what was changed."""
        found, hidden = self.list_meshes(path)
        if not found and self.others:
            raise FormatError(
                f"holds no mesh, but {count_kinds(self.others)}; turn them into meshes of polygons "
                "and export it again"
            )
        top = self.find_top(request.member)
        names, left_out = choose_parts(list(found), top, request.settings.exclude, hidden)
        notes: list[Said | Note] = [*left_out]
        if top is None and self.others:
            notes.append(
                f"left out what is no mesh: {count_kinds(self.others)}; turn them into meshes of "
                "polygons to take them along"
            )
        empty = [name for name in names if len(names) > 1 and self.is_empty(found[name])]
        if 0 < len(empty) < len(names):  # placeholders; alone, one is refused
            lacking = set(empty)
            names = [name for name in names if name not in lacking]
            notes.append(f"left out {join_truncated(empty)} (no points or no faces)")
        self._meshes: dict[str, SceneMesh] = {}
        self.claimed.hold(PART_BYTES * len(names))
        for name in names:
            with error_context(name):
                self._meshes[name] = self.open_mesh(found[name])
        times = np.array(sorted(self.list_times(list(self._meshes.values())) or {0.0}))
        step = find_step(times)
        sampled = self.sample_keys(times, step, request.settings.fps) if len(times) > 1 else None
        if sampled is not None:
            times, chosen = sampled
            step = find_step(times)
            notes.append(chosen)
        elif step is None and len(times) > 1:
            times, note = self.replace_uneven(times)
            step = find_step(times)
            notes.append(note)
        notes += self.describe_step(step)
        self.set_frames(request, len(times), self.describe_scene(times, step))
        self._times = times[list(self.frame_indices)].tolist()
        self.first = self._read_first(request, notes)
        return notes

    def _read_first(self, request: ClipRequest, notes: list[Said | Note]) -> TriMesh:
        """Read the meshes of the first frame as parts of one, and note what was changed."""
        time, polygons = self._times[0], 0
        meshes, transforms = [], []
        moves, faults = list[tuple[str, str | Change]](), list[tuple[str, str | Change]]()
        for name, mesh in self._meshes.items():
            with error_context(name):
                read = mesh.read_mesh(request.complete_first(mesh.read_moved(time)), time)
                meshes.append(read.make_mesh())
                self.claimed.hold(meshes[-1].nbytes)
            transforms.append(make_part_transform(mesh.compute_matrix(time)))
            polygons += read.polygon_count
            turned = [self.winding_note] if mesh.is_clockwise and self.winding_note else []
            moves += [(name, each) for each in (*turned, *mesh.describe_transform(time))]
            faults += [(name, each) for each in (*read.left_out, *describe_folded(meshes[-1]))]
        notes += describe_by_part(moves, len(meshes))
        notes += [describe_cut(polygons)] if polygons else []
        notes += describe_by_part(faults, len(meshes))
        return join_meshes(meshes, list(self._meshes), transforms)


def try_scene(module: str, path: str, member: str | None, exclude: Sequence[str]) -> str | None:
    """Read a file with the reader of a module; return what its library says of the first frame.

    It may say so for lack of memory, in a trial. Other frames are read for `MAX_TRIED_SECONDS`.
    """
    trials.allow(Path(path).stat().st_size)
    request = ClipRequest((Path(path),), member, settings=ClipSettings(exclude=tuple(exclude)))
    try:
        reader = import_module(module).Reader(request)
    except LibraryError as error:
        return str(error).removeprefix(f"{path}: ")
    end = process_time() + MAX_TRIED_SECONDS
    for index in takewhile(lambda _: process_time() < end, range(1, len(reader))):
        reader.read_positions(index)
    return None


def describe_by_part(found: Iterable[tuple[str, str | Change]], count: int) -> list[str]:
    """Return a sentence for each kind of change, with the parts that have it if not all of `count`.

    Changes in the same words are one: what they count is added, and what they name is joined.
    """
    sums: dict[tuple[str, str], Change] = {}
    parts: dict[tuple[str, str], dict[str, None]] = {}
    for name, each in found:
        change = Change("{}", names=(each,)) if isinstance(each, str) else each
        key = (each, "") if isinstance(each, str) else (each.words, each.noun)
        sums[key] = sums[key] + change if key in sums else change
        parts.setdefault(key, {})[name] = None
    return [
        str(change) if len(parts[key]) == count else f"{join_truncated(parts[key])}: {change}"
        for key, change in sums.items()
    ]


def count_kinds(kinds: Mapping[str, str]) -> str:
    """Count the paths of each kind, and name the first: as in "2 Cube (/a, /b)"."""
    paths: dict[str, list[str]] = {}
    for path, kind in kinds.items():
        paths.setdefault(kind, []).append(path)
    limit = max(1, MAX_NAMED // max(1, len(paths)))
    named = (f"{len(each)} {kind} ({join_truncated(each, limit)})" for kind, each in paths.items())
    return join_truncated(named)


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
            f"{group_digits(len(counts))} faces need {group_digits(total)} corners, found "
            f"{group_digits(len(corners))}; export the mesh again"
        )


def transform_points(points: NDArray[np.floating], matrix: Floats) -> Floats:
    """Transform points (m, 3), as rows, by a matrix (4, 4)."""
    with np.errstate(over="ignore", invalid="ignore"):  # checked when the frame is read
        exact = np.asarray(points, np.float64)
        if np.array_equal(matrix, np.eye(4)):
            return exact
        return np.asarray(exact @ matrix[:3, :3] + matrix[3, :3])


def blend_transforms(before: Floats, after: Floats, part: float) -> Floats:
    """Return a transform (4, 4) of rows at a part of the way between two.

    Translations and stretches, of A = P R with R a rotation, are taken linearly, and rotations turn
    evenly about one axis. If one of the two mirrors, all is taken linearly.
    """
    from scipy.spatial.transform import Rotation

    linear = np.asarray(before + part * (after - before))
    blocks = np.stack([before[:3, :3], after[:3, :3]])
    signs = np.sign(np.linalg.det(blocks))
    if signs[0] != signs[1] or not signs[0]:
        return linear
    blocks *= signs[0]
    turns = nearest_rotations_by_svd(blocks)
    stretches = blocks @ turns.swapaxes(1, 2)
    between = Rotation.from_matrix(turns[0].T @ turns[1]).as_rotvec() * part
    stretch = stretches[0] + part * (stretches[1] - stretches[0])
    linear[:3, :3] = signs[0] * stretch @ turns[0] @ Rotation.from_rotvec(between).as_matrix()
    return linear


def is_mirroring(matrix: Floats) -> bool:
    """Return whether a matrix turns a surface inside out."""
    with np.errstate(invalid="ignore", over="ignore"):
        return bool(np.linalg.det(matrix[:3, :3]) < 0)


def find_step(times: Floats) -> float | None:
    """Return the step between ascending times, (F,); None for a single one, or uneven ones."""
    steps = np.diff(times)
    if len(steps) == 0:
        return None
    mean = float(times[-1] - times[0]) / len(steps)
    return mean if (np.abs(steps - mean) <= EVEN_STEP_TOL * mean).all() else None


def sample_evenly(first: float, last: float, step: float, max_count: int) -> Floats:
    """Return times from the first on, in steps, up to the last, which rounding does not leave out.

    Raises
    ------
    FormatError
        When they are more than `max_count`.
    """
    count = floor(min((last - first) / step + EVEN_STEP_TOL, max_count)) + 1
    if count > max_count:
        raise FormatError(
            f"its keys span {(last - first) / step:.15g} frames, expected at most {max_count}; "
            "bake it to one sample per frame"
        )
    return first + step * np.arange(count, dtype=np.float64)


def snap(number: float, step: float = 1.0) -> float:
    """Return the nearest multiple of a step if a number is within `SNAP_TOL` steps of it.

    Files have times in single precision, in which frame 1 may be 1.000000052. What is no multiple
    has no digits behind the sixth.
    """
    nearest = round(number / step) * step
    return nearest if abs(number - nearest) <= SNAP_TOL * step else round(number, 6)


def snap_rate(fps: float) -> float:
    """Return the frames per second that a rate is but for rounding: whole, or that / 1.001."""
    whole = round(fps)
    if whole and abs(fps - whole) <= SNAP_TOL:
        return float(whole)
    video = round(1.001 * fps) / 1.001
    is_single = np.float32(fps) == np.float32(video) and abs(fps - video) > DOUBLE_RATE_TOL
    return video if is_single else fps


def round_frame_step(step: float | None) -> float | None:
    """Return a step of frame numbers without the digits of rounding errors; None for 1."""
    rounded = None if step is None else round(step, 6)
    return None if rounded == 1 else rounded
