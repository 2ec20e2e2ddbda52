"""Frames at known offsets of a binary file, read on demand."""

import os
import struct
import weakref
from abc import ABC, abstractmethod
from collections import deque
from io import BufferedIOBase, RawIOBase
from math import prod
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from cageik_cli.util.arrays import count_frames
from cageik_cli.util.errors import FileAccessError, FormatError
from cageik_cli.util.files import open_input

MAX_CHUNK_BYTES = 1 << 25
"""Bytes of a chunk, unless a single frame has more."""


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
        return BinaryFile(open_input(path))

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
            stored = self._read_strided(start, stop)
        else:
            stride = 3 * self.vertex_count * self._dtype.itemsize
            shape = (3 * self.vertex_count * (stop - start),)
            stored = self._file.read_array(self._offset + start * stride, self._dtype, shape)
        stored = stored.reshape([lengths[axis] for axis in self._order])
        return stored.transpose([self._order.index(axis) for axis in "fvx"])

    def _read_strided(self, start: int, stop: int) -> np.ndarray:
        """Read a part of the row of each coordinate."""
        stretches = np.empty((3 * self.vertex_count, stop - start), self._dtype)
        for row, stretch in enumerate(stretches):
            place = (row * self.frame_count + start) * self._dtype.itemsize
            self._file.read_into(stretch, self._offset + place)
        return stretches


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
