"""Base classes of the readers: clips of a mesh file per frame, and clips in one file.

Frames at known offsets of a binary file are read on demand.
"""

import hashlib
import os
import struct
import weakref
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from io import BufferedIOBase, RawIOBase
from math import prod
from pathlib import Path
from threading import Lock
from types import MappingProxyType
from typing import Any

import numpy as np

from cageik_cli.formats.base.choose_parts import select_parts
from cageik_cli.formats.base.file_numbers import FileSeries
from cageik_cli.formats.base.files import decompress, file_suffix, hash_file
from cageik_cli.formats.base.mesh_data import (
    FileMesh,
    check_connectivity,
    check_not_points,
    describe_folded,
)
from cageik_cli.formats.base.sequence import ClipRequest, MeshSequence
from cageik_cli.formats.settings import Scene, SceneHints
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, count_frames
from cageik_cli.util.errors import (
    ConnectivityError,
    FileAccessError,
    FormatError,
    MissingFrameError,
    SettingError,
    error_context,
)
from cageik_cli.util.files import Mark, mark_file, open_content, read_input
from cageik_cli.util.messages import Note, Said, say
from cageik_cli.util.text import group_digits, to_unicode

MAX_CHUNK_BYTES = 1 << 25
"""Bytes of a chunk, unless a single frame has more."""


class FrameFileReader(MeshSequence):
    """Frames from mesh files of one suffix; a format subclasses this and says how to parse a file.

    The same class reads single meshes, see `formats.open.load_mesh`. Names that end in `.gz`
    are unpacked first, where a format lists such suffixes (`base.files.with_gzip`).

    Attributes
    ----------
    numbers_vertices : bool
        Whether a file says which corners of its faces are one vertex.
    """

    numbers_vertices = True

    @classmethod
    @abstractmethod
    def parse(cls, data: bytes) -> FileMesh:
        """Parse the content of a file, which is not empty; errors do not name the file."""

    @classmethod
    def number_vertices(cls, mesh: FileMesh, rest: TriMesh) -> FileMesh:
        """Return a first frame with the vertices of the rest pose, if it has none of its own."""
        return mesh

    @classmethod
    def make_frame_parser(
        cls, data: bytes, mesh: FileMesh
    ) -> Callable[[bytes], Floats | None] | None:
        """Return a quicker way to read frames like the first, which holds `data` and `mesh`.

        It takes the content of a frame, and returns the vertices (m, 3) if all faces are the first
        frame's, else None.
        """
        return None

    @classmethod
    def read_attributes(cls, data: bytes, mesh: FileMesh) -> FileMesh:
        """Return what was parsed with all else that the file, unpacked, says of the surface.

        Frames are compared and solved without it, so only the first frame's is read.
        """
        return mesh

    @classmethod
    def read_library(cls, path: Path, mesh: FileMesh) -> FileMesh:
        """Return a mesh with what the files say that the file at `path` names."""
        return mesh

    def __init__(self, request: ClipRequest) -> None:
        series = FileSeries(request.paths, request.settings.gaps)
        chosen = series.trim(request.select_frames(len(series.paths), series.scene))
        self._missing = {k: series.missing[n] for k, n in enumerate(chosen) if n in series.missing}
        self.missing = frozenset(self._missing)
        self.scene = series.scene.restrict_to_frames(chosen)
        self._paths = paths = [series.paths[n] for n in chosen]
        self._suffix, self._member = file_suffix(paths[0]), request.member
        self.names = tuple(to_unicode(path.name) for path in paths)
        self._digests: dict[int, bytes] = {}
        with error_context(paths[0]):
            data = self._read(0)
            parsed = parse_mesh(type(self), data)
            is_whole = request.member is None and not request.settings.exclude
            if request.rest is not None and is_whole:
                parsed = self.number_vertices(parsed, request.rest.mesh)
            completed = replace(parsed, vertices=request.complete_first(parsed.vertices))
            mesh = self.read_library(paths[0], self.read_attributes(data, completed))
            # Its shape decides how polygons are cut, for all frames.
            self._whole = mesh.make_mesh()
            self.first, self._kept, left_out = select_parts(
                self._whole, request.member, request.settings.exclude
            )
        found = (*mesh.notes, *map(str, describe_folded(self._whole)))
        notes = (Note(f"{text}, as in all frames", place=self.names[0]) for text in found)
        self.notes = (*map(Note, series.notes), *notes, *map(Note, left_out))
        self._parse_alike = self.make_frame_parser(data, parsed)

    def read_positions(self, index: int) -> Floats:
        """Read the vertices of one file, and compare its faces with the first frame's."""
        with error_context(self._paths[index]):
            data = self._read(index)
            vertices = self._parse_alike(data) if self._parse_alike is not None else None
            if vertices is None:
                mesh = parse_mesh(type(self), data, is_first=False)
                expected = self._whole.fan_triangulated
                check_connectivity(len(mesh.vertices), mesh.fans, expected, "the rest pose")
                vertices = mesh.vertices
            return vertices if self._kept is None else vertices[self._kept]

    def location(self, index: int) -> str:
        """Return the frame's path, and what is read of it."""
        path = self._paths[index]
        return str(path) if self._member is None else f"{path}::{self._member}"

    def digest(self, index: int) -> bytes:
        """Return the SHA-256 digest of the frame's file, as it was when it was last read."""
        if index not in self._digests:
            with error_context(self._paths[index]):
                self._read(index)
        return self._digests[index]

    def content_digest(self, index: int) -> bytes:
        """Return the digest of the frame's file, and of which of its parts are read."""
        digest = self.digest_or_zeros(index)
        if self._kept is None:
            return digest
        return hashlib.sha256(digest + self._kept.tobytes()).digest()

    def set_digests(self, start: int, digests: Sequence[bytes]) -> None:
        """Take digests of files that were read elsewhere; zeros stand for an unknown digest."""
        self._digests |= {k: digest for k, digest in enumerate(digests, start) if any(digest)}

    def describe_source(self) -> dict[str, Any]:
        """Return the names of the first and last file, their count, and a digest over all."""
        digests = b"".join(map(self.content_digest, range(len(self))))
        name = f"{self.names[0]} ... {self.names[-1]}" if len(self) > 1 else self.names[0]
        return {
            "name": name if self._member is None else f"{name}::{to_unicode(self._member)}",
            "files": len(self) - len(self.missing),
            "sha256": hashlib.sha256(digests).hexdigest(),
        }

    def _read(self, index: int) -> bytes:
        if index in self._missing:
            raise MissingFrameError(self._missing[index])
        data = read_input(self._paths[index])
        self._digests[index] = hashlib.sha256(data).digest()
        return decompress(data, self._suffix)


def parse_mesh(reader: type[FrameFileReader], data: bytes, *, is_first: bool = True) -> FileMesh:
    """Parse the content of a mesh file, unpacked.

    Only the first of several may be refused as points: others that lack their faces are cut off.
    """
    mesh = reader.parse(data)
    if is_first:
        check_not_points(len(mesh.vertices), len(mesh.corner_counts))
    return mesh


class ClipFile(MeshSequence):
    """Frames of one file, each named by its number; formats implement `read_positions`.

    `set_frames` sets `frame_indices`: which of the file's frames the clip's are.
    """

    path: Path
    frame_indices: range
    _reading: tuple[object, ...] = ()
    _marks: Mapping[Path, Mark | None] = MappingProxyType({})

    def set_frames(self, request: ClipRequest, count: int, scene: SceneHints | None = None) -> None:
        """Select the requested frames of the `count` in the file, and name them.

        `scene` has the settings that the file gives for all of them.
        """
        self.path = request.path
        self._marks = self._marks or {self.path: mark_file(self.path)}
        scene = scene or SceneHints()
        self.frame_indices = request.select_frames(count, scene)
        settings = request.settings
        self._reading = (request.member, settings.layout, *settings.exclude)
        self.scene = scene.restrict_to_frames(self.frame_indices)
        member = f"::{request.member}" if request.member is not None else ""
        self._name = to_unicode(self.path.name + member)
        timeline = self.scene.override(Scene()).make_timeline(len(self.frame_indices))
        numbers = map(timeline.number_frame, range(timeline.count))
        self.names = tuple(f"{self._name}[{number}]" for number in numbers)

    def use_rest_faces(self, request: ClipRequest, vertex_count: int) -> None:
        """Take the faces of the rest pose, for a file of `vertex_count` vertices and no faces."""
        rest = request.rest
        with error_context(self.path):
            if rest is None:
                raise SettingError(
                    say("holds positions but no faces; give a mesh with the faces by `rest=`")
                )
            if vertex_count != len(rest.mesh.vertices):
                raise ConnectivityError(
                    f"{group_digits(vertex_count)} vertices, the rest pose has "
                    f"{group_digits(len(rest.mesh.vertices))}; all "
                    "must share one connectivity"
                )
        positions = self.read_positions(0)
        with error_context(self.names[0]):
            self.first = rest.mesh.move(request.complete_first(positions))
        self.needs_rest = True

    def digest(self, index: int) -> bytes:
        """Return the SHA-256 digest of the file."""
        return self._digest

    def content_digest(self, index: int) -> bytes:
        """Return a digest of the file, and of where and how the frame is read from it."""
        place = f"{self.frame_indices[index]} {self._reading}".encode()
        return hashlib.sha256(self.digest_or_zeros(index) + place).digest()

    def set_digests(self, start: int, digests: Sequence[bytes]) -> None:
        """Take the digest of the file: that of any frame."""
        self._digest = digests[0]

    def describe_source(self) -> dict[str, Any]:
        """Return the name of the file, and of what is read of it, and the digest of the file.

        Raises FileAccessError if the file was written again since it was opened: the digest may not
        be of what was read.
        """
        source = {"name": self._name, "sha256": self._digest.hex()}
        for path, mark in self._marks.items():
            with error_context(path):
                if mark_file(path) != mark:
                    raise FileAccessError("changed while it was read; run again")
        return source

    @cached_property
    def _digest(self) -> bytes:
        return hash_file(self.path)


def check_zero_based(faces: np.ndarray, vertex_count: int) -> None:
    """Refuse faces that count vertices from 1: they name `vertex_count` and never 0."""
    if faces.size and faces.min() > 0 and faces.max() == vertex_count:
        raise FormatError(
            f"faces name vertices {faces.min()} to {vertex_count} of {vertex_count}, so "
            "they count from 1; subtract 1 and write the file again"
        )


class ChunkedFrames(ABC):
    """Frames read in chunks, by any thread.

    A chunk has `chunk_frames` frames, which are stored together, or what fits; a coordinate has
    `itemsize` bytes.
    """

    def __init__(
        self, frame_count: int, vertex_count: int, chunk_frames: int, itemsize: int
    ) -> None:
        self.frame_count, self.vertex_count = frame_count, vertex_count
        fitting = count_frames(MAX_CHUNK_BYTES, vertex_count, itemsize=itemsize)
        self._chunk_size = max(1, min(chunk_frames, fitting))
        self._cached_chunks: deque[tuple[int, np.ndarray]] = deque()
        self._lock = Lock()

    @abstractmethod
    def read_chunk(self, start: int, stop: int) -> np.ndarray:
        """Read frames `start` up to `stop`, exclusive: (k, m, 3)."""

    def read_frame(self, index: int) -> np.ndarray:
        """Read the positions of one frame, (m, 3)."""
        start = index - index % self._chunk_size
        with self._lock:
            chunk = next((found for first, found in self._cached_chunks if first == start), None)
            if chunk is None:
                # Threads that read ahead need both sides of a border.
                if len(self._cached_chunks) == 2:
                    self._cached_chunks.popleft()  # before there is a third
                chunk = self.read_chunk(start, min(start + self._chunk_size, self.frame_count))
                self._cached_chunks.append((start, chunk))
        return np.asarray(chunk[index - start])


@dataclass(frozen=True, slots=True, eq=False)
class ArrayClip:
    """The content of a file that holds a clip.

    Attributes
    ----------
    faces : (t, 3) integers, optional
        The rest pose's if absent.
    scene : SceneHints
        Scene settings that the file gives for all its frames.
    notes : tuple of str or Text
        What is unusual in it, one sentence each.
    """

    frames: ChunkedFrames
    faces: np.ndarray | None = None
    scene: SceneHints = field(default_factory=SceneHints)
    notes: tuple[Said, ...] = ()


class ArrayClipFile(ClipFile):
    """Frames of such a file; formats implement `open_clip`."""

    def __init__(self, request: ClipRequest) -> None:
        self.path = request.path
        with error_context(self.path):
            clip = self.open_clip(request)
            self.set_frames(request, clip.frames.frame_count, clip.scene)
        self._frames = clip.frames
        name = to_unicode(self.path.name)
        self.notes = tuple(Note(text, place=name) for text in clip.notes)
        if clip.faces is None:
            self.use_rest_faces(request, clip.frames.vertex_count)
            return
        positions = self.read_positions(0)
        with error_context(self.path):
            check_zero_based(clip.faces, clip.frames.vertex_count)
            self.first = TriMesh(request.complete_first(positions), clip.faces)

    @classmethod
    @abstractmethod
    def open_clip(cls, request: ClipRequest) -> ArrayClip:
        """Open the file, and check what its header announces against its size.

        Errors do not name the file.
        """

    @classmethod
    def describe_contents(cls, request: ClipRequest) -> list[tuple[str, Said]]:
        """Describe a file that has no faces."""
        path = request.path
        with error_context(path):
            clip = cls.open_clip(request)
        if clip.faces is not None:
            return []
        return [
            ("holds", say("positions without faces, which cageik extract takes from `rest=`")),
            ("frames", str(clip.frames.frame_count)),
            ("vertices", str(clip.frames.vertex_count)),
            *([("scene", clip.scene.description)] if clip.scene.description else []),
            *(("note", note) for note in clip.notes),
        ]

    def read_positions(self, index: int) -> np.ndarray:
        """Read the vertices of one frame."""
        with error_context(self.path):
            return self._frames.read_frame(self.frame_indices[index])


class BinaryFile:
    """An open file that any thread reads at any offset; it is closed with its last user.

    It had `size` bytes when it was opened.
    """

    def __init__(self, stream: RawIOBase | BufferedIOBase) -> None:
        weakref.finalize(self, stream.close)
        self._stream, self._lock = stream, Lock()
        self.size = stream.seek(0, os.SEEK_END)

    @staticmethod
    def open(path: Path) -> "BinaryFile":
        """Open a file for reading."""
        return BinaryFile(open_content(path))

    def read_header(self, layout: str, noun: str) -> tuple[Any, ...]:
        """Unpack what is at the beginning, as `struct` does; `noun` is what the file should be."""
        size = struct.calcsize(layout)
        if self.size < size:
            raise FormatError(f"{self.size} bytes, {noun} has at least {size}; export it again")
        return struct.unpack(layout, self.read_array(0, np.dtype(np.uint8), (size,)).tobytes())

    def read_array(self, offset: int, dtype: np.dtype, shape: tuple[int, ...]) -> np.ndarray:
        """Read an array at `offset`, its last axis fastest."""
        try:
            array = np.empty(shape, dtype)
        except MemoryError as error:
            size = prod(shape) * dtype.itemsize
            raise FileAccessError(
                f"{size} bytes of it do not fit in memory; use a machine with more"
            ) from error
        self.read_into(array, offset)
        return array

    def read_into(self, array: np.ndarray, offset: int) -> None:
        """Read into a contiguous array, from `offset`."""
        left = array.reshape(-1).view(np.uint8).data
        with self._lock:
            try:
                self._stream.seek(offset)
                while left:
                    count = self._stream.readinto(left)
                    if not count:
                        raise FileAccessError("became shorter after it was opened; run again")
                    left = left[count:]
            except OSError as error:
                raise FileAccessError(f"cannot be read: {error.strerror or error}") from error


class StoredFrames(ChunkedFrames):
    """Frames of an array in a file, read one by one unless the frame axis is the fastest.

    Parameters
    ----------
    offset : int
        First byte of the array.
    axis_order : str
        Axes, the slowest first: f frames, v vertices, x coordinates.
    """

    def __init__(
        self,
        file: BinaryFile,
        offset: int,
        dtype: np.dtype,
        *,
        frame_count: int,
        vertex_count: int,
        axis_order: str = "fvx",
    ) -> None:
        self._file, self._offset, self._dtype, self._order = file, offset, dtype, axis_order
        self._is_frame_axis_last = axis_order[2] == "f"
        chunk_frames = frame_count if self._is_frame_axis_last else 1
        super().__init__(frame_count, vertex_count, chunk_frames, dtype.itemsize)

    def read_chunk(self, start: int, stop: int) -> np.ndarray:
        """Read frames `start` up to `stop`, exclusive: (k, m, 3)."""
        lengths = {"f": stop - start, "v": self.vertex_count, "x": 3}
        is_whole = stop - start == self.frame_count
        if self._is_frame_axis_last and not is_whole:
            stored = np.empty((3 * self.vertex_count, stop - start), self._dtype)
            for row, stretch in enumerate(stored):  # of each coordinate
                place = (row * self.frame_count + start) * self._dtype.itemsize
                self._file.read_into(stretch, self._offset + place)
        else:
            stride = 3 * self.vertex_count * self._dtype.itemsize
            shape = (3 * self.vertex_count * (stop - start),)
            stored = self._file.read_array(self._offset + start * stride, self._dtype, shape)
        stored = stored.reshape([lengths[axis] for axis in self._order])
        return stored.transpose([self._order.index(axis) for axis in "fvx"])


def check_file_size(file: BinaryFile, expected: int, counts: dict[str, int]) -> None:
    """Refuse a header whose counts are not above zero, or need another size of the file."""
    announced = ", ".join(f"{count} {noun}" for noun, count in counts.items())
    if min(counts.values()) < 1:
        raise FormatError(f"announces {announced}, expected at least one of each; export it again")
    if file.size != expected:
        fault = "cut short or damaged" if file.size < expected else "damaged"
        raise FormatError(
            f"announces {announced}, which take {expected} bytes, but has {file.size}; it is "
            f"{fault}, export it again"
        )
