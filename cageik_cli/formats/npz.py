"""Numpy files: clips, and weights of vertices, which may be in a text, too.

A clip is an array of positions, and in a `.npz` perhaps one of faces. Arrays are found without
loading them. Weights are one number per vertex, or one row of a `.npy` per frame.
"""

import io
import shutil
import tempfile
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from math import prod
from pathlib import Path
from tokenize import TokenError
from typing import IO

import numpy as np

from cageik_cli.formats.base.files import check_unpacked_array, check_unpacked_size, describe_source
from cageik_cli.formats.base.readers import (
    ArrayClip,
    ArrayClipFile,
    BinaryFile,
    StoredFrames,
    check_zero_based,
)
from cageik_cli.formats.base.sequence import ClipRequest
from cageik_cli.formats.base.writers import Animation, AnimationWriter
from cageik_cli.formats.settings import LAYOUTS, SceneHints, parse_scene_metadata
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FileAccessError, FormatError, SettingError, error_context
from cageik_cli.util.files import open_content, open_input, read_input
from cageik_cli.util.messages import say

VERTEX_NAMES = ("vertices", "verts", "V", "v")

FACE_NAMES = ("faces", "tris", "F", "f")

MAX_NPY_HEADER_BYTES = 1 << 14
"""Bytes that are read for a header; numpy itself accepts 10 000 characters."""

_COPY_BYTES = 1 << 20

_HEADER_READERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}

# What numpy and zipfile raise for files that are cut, encrypted or not of arrays.
_READ_ERRORS = (OSError, ValueError, TypeError, KeyError, EOFError, MemoryError, RuntimeError,
            SyntaxError, TokenError, zlib.error, zipfile.BadZipFile)  # fmt: skip

MAX_ROWS_BYTES = 1 << 22
"""Largest part of the weights of frames that is checked at once."""


def list_layouts(shape: tuple[int, ...], layout: str | None) -> list[str]:
    """List the orders that the axes of an array may have; only `layout` if it is given."""
    asked = LAYOUTS if layout is None else (layout,)
    found = [order for order in asked if len(shape) == 3 and shape[order.index("x")] == 3]
    if not found or min(shape) < 1:
        axes = {"f": "frames", "v": "vertices", "x": "3"}
        expected = " or ".join(f"({', '.join(axes[axis] for axis in order)})" for order in asked)
        raise FormatError(f"positions have shape {shape}, expected {expected}")
    return found


def choose_layout(layouts: list[str], shape: tuple[int, ...], expected_vertices: int | None) -> str:
    """Return the only possible or the only likely order of the axes of an array.

    An order with as many vertices as the faces name is preferred to one with more; one with fewer
    is impossible.
    """
    if len(layouts) == 1:
        return layouts[0]
    counts = {order: shape[order.index("v")] for order in layouts}
    least = expected_vertices or 0
    exact = [order for order, count in counts.items() if count == expected_vertices]
    larger = [order for order, count in counts.items() if count > least]
    best = exact or larger or layouts
    if len(best) > 1:
        texts = (
            f"{order} ({shape[order.index('f')]} frames of {counts[order]} vertices)"
            for order in best
        )
        raise SettingError(
            f"positions can be read as {' or '.join(texts)}; " + say("choose with `layout=`")
        )
    return best[0]


class Reader(ArrayClipFile):
    """Frames of one `.npz` or `.npy`, whose axes may be in any order of `LAYOUTS`."""

    suffixes = (".npz", ".npy")
    has_layout = True

    @classmethod
    def open_clip(cls, request: ClipRequest) -> ArrayClip:
        """Find the arrays, and which axis is which."""
        path = request.path
        if path.suffix.lower() == ".npy":
            return ArrayClip(_open_frames(open_npy(path), None, request))
        archive = NpzArchive(path)
        if not archive.names.intersection(VERTEX_NAMES) and "poses" in archive.names:
            raise FormatError(
                "holds body parameters (AMASS or SMPL: poses, betas, trans), not vertices; "
                "evaluate the body model and write its vertices"
            )
        positions, faces = _find_array(archive, VERTEX_NAMES), None
        if archive.names.intersection(FACE_NAMES):
            array = _find_array(archive, FACE_NAMES)
            if array.dtype.kind not in "iu" or len(array.shape) != 2 or array.shape[1] != 3:
                raise FormatError(
                    f"faces are {array.dtype} of shape {array.shape}, expected integers of shape "
                    "(count, 3)"
                )
            faces = array.read()
            if not faces.size:
                raise FormatError("there are 0 faces, expected at least 1")
        metadata = {name: archive.read_scalar(name) for name in SceneHints.__slots__}
        return ArrayClip(
            _open_frames(positions, faces, request), faces, *parse_scene_metadata(metadata)
        )


@dataclass(frozen=True, slots=True, eq=False)
class FileArray:
    """An array in a file.

    Attributes
    ----------
    offset : int
        Its first byte.
    dtype : dtype
        Of numbers, or of text.
    is_fortran_order : bool
        Whether its first axis is the fastest, not its last.
    """

    file: BinaryFile
    offset: int
    dtype: np.dtype
    shape: tuple[int, ...]
    is_fortran_order: bool

    def read(self) -> np.ndarray:
        """Read the whole array."""
        array = self.file.read_array(
            self.offset, self.dtype, self.shape[:: 1 - 2 * self.is_fortran_order]
        )
        return array.T if self.is_fortran_order else array

    def read_rows(self, start: int, stop: int) -> np.ndarray:
        """Read rows `start` up to `stop`, exclusive, of an array of two dimensions."""
        rows, columns = self.shape
        stop, size = min(stop, rows), self.dtype.itemsize
        if not self.is_fortran_order:
            shape = (stop - start, columns)
            return self.file.read_array(self.offset + start * columns * size, self.dtype, shape)
        found = np.empty((columns, stop - start), self.dtype)
        for number, column in enumerate(found):
            self.file.read_into(column, self.offset + (number * rows + start) * size)
        return found.T


class NpzArchive:
    """The arrays of a `.npz`."""

    def __init__(self, path: Path) -> None:
        self._path, self._file = path, BinaryFile.open(path)
        with (
            _wrap_read_errors("a sound .npz of plain arrays"),
            open_input(path) as file,
            zipfile.ZipFile(file) as archive,
        ):
            self._members = {
                info.filename.removesuffix(".npy"): info
                for info in archive.infolist()
                if info.filename.endswith(".npy")
            }
        self.names = set(self._members)

    def open_array(self, name: str) -> FileArray:
        """Open one of the arrays; a compressed one is unpacked into a temporary file."""
        info = self._members[name]
        with error_context(f"`{name}`"), _wrap_read_errors("a sound member of a .npz"):
            if info.flag_bits & 1:
                raise FormatError("is encrypted; write the file with numpy.savez")
            if info.compress_type == zipfile.ZIP_STORED:
                return _open_array(self._file, self._find_offset(info), info.file_size)
            if info.compress_type == zipfile.ZIP_DEFLATED:
                array = _open_array(self._decompress(info), 0, info.file_size)
                check_unpacked_array(array.shape, array.dtype, info.compress_size)
                return array
            raise FormatError(
                f"is compressed by method {info.compress_type}, expected deflate or none; write "
                "the file with numpy.savez"
            )

    def read_scalar(self, name: str) -> np.ndarray | None:
        """Read a single number or text; None if it is absent, or something else."""
        if name not in self.names or self._members[name].file_size > _COPY_BYTES:
            return None
        array = self.open_array(name)
        plain = array.shape == () and array.dtype.kind in "fiuU" and array.dtype.itemsize
        return array.read() if plain else None

    def _find_offset(self, info: zipfile.ZipInfo) -> int:
        """Return where the bytes of an uncompressed member begin: behind its own header."""
        head = self._file.read_array(info.header_offset, np.dtype(np.uint8), (30,)).tobytes()
        lengths = np.frombuffer(head, "<u2", 2, 26)
        place = info.header_offset + 30 + int(lengths.sum())
        size = info.file_size
        if head[:4] != b"PK\3\4" or size != info.compress_size or place + size > self._file.size:
            raise FormatError(
                f"is not at byte {info.header_offset}, as the archive says; write it again"
            )
        return place

    def _decompress(self, info: zipfile.ZipInfo) -> BinaryFile:
        """Unpack a member into a temporary file, unless it is too large for it or for the disk."""
        folder = tempfile.gettempdir()
        check_unpacked_size(info.file_size, min(info.compress_size, self._file.size))
        if info.file_size > (free := shutil.disk_usage(folder).free):
            raise FileAccessError(
                f"needs {info.file_size} bytes unpacked, and {folder} has {free} free; set TMPDIR "
                "to a larger folder, or write the file with numpy.savez"
            )
        with ExitStack() as stack:
            try:
                target = stack.enter_context(tempfile.TemporaryFile())
                with (
                    open_input(self._path) as file,
                    zipfile.ZipFile(file) as archive,
                    archive.open(info) as member,
                ):
                    size = 0
                    while size <= info.file_size and (part := member.read(_COPY_BYTES)):
                        size += target.write(part)
            except OSError as error:
                raise FileAccessError(
                    f"cannot be unpacked into {folder} ({error}); set TMPDIR "
                    "to another folder, or write the file with numpy.savez"
                ) from error
            if size != info.file_size:
                raise FormatError(f"ends after {size} of {info.file_size} bytes; write it again")
            stack.pop_all()  # BinaryFile closes it
            return BinaryFile(target)


def _find_array(archive: NpzArchive, names: tuple[str, ...]) -> FileArray:
    found = [name for name in names if name in archive.names]
    if len(found) != 1:
        held = ", ".join(found) or "none"
        raise FormatError(f"holds {held} of the arrays {', '.join(names)}, expected exactly one")
    return archive.open_array(found[0])


def _open_frames(array: FileArray, faces: np.ndarray | None, request: ClipRequest) -> StoredFrames:
    """Open the frames of an array of positions, in the most likely order of its axes."""
    if array.dtype.kind != "f":
        raise FormatError(
            f"positions are {array.dtype} of shape {array.shape}, expected floating-point numbers"
        )
    layouts = list_layouts(array.shape, request.settings.layout)
    expected_vertices = None
    if faces is not None:
        for layout in layouts:
            check_zero_based(faces, array.shape[layout.index("v")])
        expected_vertices = int(faces.max()) + 1
    elif request.rest is not None:
        expected_vertices = len(request.rest.mesh.vertices)
    layout = choose_layout(layouts, array.shape, expected_vertices)
    return StoredFrames(
        array.file,
        array.offset,
        array.dtype,
        frame_count=array.shape[layout.index("f")],
        vertex_count=array.shape[layout.index("v")],
        axis_order=layout[::-1] if array.is_fortran_order else layout,
    )


def fixed_date_zipinfo(name: str) -> zipfile.ZipInfo:
    """Return a member with the first date of zip: the same bytes at any time."""
    return zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))


class Writer(AnimationWriter):
    """Writes frames in double precision, uncompressed, so that each can be read alone."""

    suffixes = (".npz",)

    def __init__(self, target: Path, animation: Animation) -> None:
        with ExitStack() as stack:
            self._archive = stack.enter_context(zipfile.ZipFile(target, "w"))
            scene = animation.scene
            for name, value in (
                ("faces", animation.rest.faces.astype(np.int32)),
                ("fps", np.float64(scene.fps)),
                ("start", np.float64(scene.start)),
                ("up_axis", np.str_(scene.up_axis)),
                ("metres_per_unit", np.float64(scene.metres_per_unit)),
                ("frame_step", np.float64(scene.frame_step)),
            ):
                with self._open_member(name) as stream:
                    np.lib.format.write_array(stream, np.asarray(value), allow_pickle=False)
            self._frames = stack.enter_context(self._open_member("vertices"))
            shape = (animation.frame_count, *animation.rest.vertices.shape)
            header = {"descr": "<f8", "fortran_order": False, "shape": shape}
            np.lib.format.write_array_header_1_0(self._frames, header)
            self._open = stack.pop_all()

    def append(self, frames: Floats) -> None:
        """Write the next frames."""
        self._frames.write(np.ascontiguousarray(frames, "<f8").data)

    def _open_member(self, name: str) -> IO[bytes]:
        return self._archive.open(fixed_date_zipinfo(f"{name}.npy"), "w", force_zip64=True)


def open_npy(path: Path) -> FileArray:
    """Open the array of a `.npy`."""
    file = BinaryFile.open(path)
    with _wrap_read_errors("a sound .npy of plain numbers"):
        return _open_array(file, 0, file.size)


def _open_array(file: BinaryFile, offset: int, size: int) -> FileArray:
    """Open the array whose `.npy` is at `offset` and has `size` bytes."""
    head = file.read_array(offset, np.dtype(np.uint8), (min(size, MAX_NPY_HEADER_BYTES),)).tobytes()
    stream = io.BytesIO(head)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of Python 2's long numbers, and odd ones
        version = np.lib.format.read_magic(stream)
        if version not in _HEADER_READERS:
            raise FormatError(f"is a .npy of version {version}, expected (1, 0) or (2, 0)")
        shape, is_reversed, kind = _HEADER_READERS[version](stream)
    claimed = stream.tell() + prod(shape) * kind.itemsize
    if not kind.hasobject and (min(shape, default=0) < 0 or claimed != size):
        raise FormatError(
            f"announces an array of shape {shape} of {kind}, which takes {claimed} bytes, but has "
            f"{size}; it is cut short or damaged, write it again"
        )
    return FileArray(file, offset + stream.tell(), kind, shape, is_reversed)


@contextmanager
def _wrap_read_errors(expected: str) -> Iterator[None]:
    """Turn what numpy and zipfile raise inside into a FormatError."""
    try:
        yield
    except _READ_ERRORS as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise FormatError(f"is not {expected} ({reason}); write it again") from error


@dataclass(frozen=True, slots=True)
class FrameWeightsFile:
    """Weights of the vertices of each frame, in a `.npy` file that is read frame by frame.

    Attributes
    ----------
    shape : tuple of int
        Frames and vertices.
    largest : float
        Of all weights in the file.
    mean_share : float
        The mean of those above 0, as the others are missing data, over the largest.
    """

    path: Path
    shape: tuple[int, ...]
    largest: float
    mean_share: float

    def read(self, start: int, stop: int) -> Floats:
        """Read the weights of frames `start` up to `stop`, exclusive: (k, m), from 0 to 1."""
        with error_context(self.path):
            array = open_npy(self.path)
            if array.shape != self.shape:
                raise FileAccessError("was written again after it was opened; run again")
            return np.asarray(array.read_rows(start, stop), np.float64) / self.largest


def open_frame_weights(path: Path, frames: int, vertices: int) -> FrameWeightsFile | None:
    """Open the weights of each frame of a clip; None for a file that is not an array (F, m)."""
    if path.suffix.lower() != ".npy":
        return None
    with error_context(path):
        open_content(path).close()
        try:
            array = open_npy(path)
        except FormatError:
            return None  # whoever reads one weight per vertex says what is wrong
        if len(array.shape) != 2:
            return None
        if array.shape != (frames, vertices):
            raise FormatError(
                f"weights of frames have shape {array.shape}, expected ({frames}, {vertices}): the "
                "frames that are taken and the vertices of the model"
            )
        if array.dtype.kind not in "fiub":
            raise FormatError(f"holds {array.dtype} values, expected numbers")
        return FrameWeightsFile(path, array.shape, *_check_rows(array))


def _check_rows(array: FileArray) -> tuple[float, float]:
    """Return the largest weight, and the mean of those above 0 over it; rows are read in parts."""
    rows, columns = array.shape
    size = max(1, MAX_ROWS_BYTES // (8 * columns))
    largest, total, count = 0.0, 0.0, 0
    for start in range(0, rows, size):
        with np.errstate(over="ignore", invalid="ignore"):  # what is infinite is refused
            part = np.asarray(array.read_rows(start, start + size), np.float64)
        is_wrong = ~(np.isfinite(part) & (part >= 0))
        if is_wrong.any():
            frame, vertex = np.argwhere(is_wrong)[0]
            raise FormatError(
                f"the weight of vertex {vertex} in row {start + frame} is {part[frame, vertex]}, "
                "expected a finite number of 0 or above"
            )
        most = float(part.max())
        if most > largest:
            total, largest = total * (largest / most), most
        if largest:
            total += float((part / largest).sum())  # a sum of large weights could overflow
        count += int(np.count_nonzero(part))
    if largest == 0:
        raise FormatError("all vertex weights are zero; expected at least one above 0")
    return largest, total / count


def read_vertex_weights(path: Path) -> tuple[Floats, dict[str, str]]:
    """Read weights from `.npy`, or from text with one number per line; also name and digest."""
    with error_context(path):
        data = read_input(path)
        try:
            if path.suffix.lower() == ".npy":
                weights = np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
            else:
                weights = _parse_text(data)
            if weights.dtype.kind not in "fiub":
                raise FormatError(f"it holds {weights.dtype} values")
        except (
            FormatError,
            ValueError,
            TypeError,
            EOFError,
            MemoryError,
            SyntaxError,
            TokenError,
        ) as error:
            # What libraries say quotes the file, which may be any that a file of options names.
            reason = f" ({error})" if isinstance(error, FormatError) else ""
            raise FormatError(
                f"is not a list of numbers{reason}; expected one per line, or a .npy array"
            ) from error
        with np.errstate(over="ignore", invalid="ignore"):  # infinite weights are refused later
            return np.asarray(weights, dtype=np.float64), describe_source(path, data)


def _parse_text(data: bytes) -> Floats:
    """Parse numbers with blanks between them; the message on a fault quotes nothing."""
    words = data.decode().replace("_", "?").split()  # 1_0 is Python's, not a file's
    numbers = np.empty(len(words))
    for k, word in enumerate(words):
        try:
            numbers[k] = float(word)
        except ValueError as error:
            raise FormatError(f"word {k + 1} is not a number") from error
    return numbers
