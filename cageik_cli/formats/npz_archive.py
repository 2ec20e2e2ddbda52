"""Arrays in `.npy` and `.npz` files: found without loading them."""

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

from cageik_cli.formats.base.binary_frames import BinaryFile
from cageik_cli.formats.base.files import check_unpacked_array, check_unpacked_size
from cageik_cli.util.errors import FileAccessError, FormatError, error_context
from cageik_cli.util.files import open_input

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


def open_npy(path: Path) -> FileArray:
    """Open the array of a `.npy`."""
    file = BinaryFile.open(path)
    with _wrap_read_errors("a sound .npy of plain numbers"):
        return _open_array(file, 0, file.size)


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
                self._check_claimed_size(info)
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

    def _check_claimed_size(self, info: zipfile.ZipInfo) -> None:
        """Refuse a member that announces a lot more than it has, or more than the disk can hold."""
        size, folder = info.file_size, tempfile.gettempdir()
        packed = min(info.compress_size, self._file.size)
        check_unpacked_size(size, packed)
        if size > (free := shutil.disk_usage(folder).free):
            raise FileAccessError(
                f"needs {size} bytes unpacked, and {folder} has {free} free; set TMPDIR to a "
                "larger folder, or write the file with numpy.savez"
            )

    def _decompress(self, info: zipfile.ZipInfo) -> BinaryFile:
        """Unpack a member into a temporary file."""
        with ExitStack() as stack:
            try:
                target = stack.enter_context(tempfile.TemporaryFile())
                with (
                    open_input(self._path) as file,
                    zipfile.ZipFile(file) as archive,
                    archive.open(info) as member,
                ):
                    size = _copy_at_most(member, target, info.file_size)
            except OSError as error:
                raise FileAccessError(
                    f"cannot be unpacked into {tempfile.gettempdir()} ({error}); set TMPDIR "
                    "to another folder, or write the file with numpy.savez"
                ) from error
            if size != info.file_size:
                raise FormatError(f"ends after {size} of {info.file_size} bytes; write it again")
            stack.pop_all()  # BinaryFile closes it
            return BinaryFile(target)


def _copy_at_most(source: IO[bytes], target: IO[bytes], limit: int) -> int:
    """Copy until the end, or just beyond the limit; return the bytes copied."""
    count = 0
    while count <= limit and (part := source.read(_COPY_BYTES)):
        count += target.write(part)
    return count


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
        said = (str(error).splitlines() or [type(error).__name__])[0]
        raise FormatError(f"is not {expected} ({said}); write it again") from error
