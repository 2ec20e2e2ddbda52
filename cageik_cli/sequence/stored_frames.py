"""Frames at known places of a binary file, read when they are asked for."""

import os
import weakref
from dataclasses import dataclass
from io import BufferedIOBase, RawIOBase
from math import prod
from pathlib import Path
from threading import Lock

import numpy as np

from cageik_cli.errors import InputError
from cageik_cli.sequence.runs import Runs, run_size


class BinaryFile:
    """An open file read at any offset, by any thread; it is closed with its last user.

    Attributes
    ----------
    size : int
        Bytes it had when it was opened.
    """

    def __init__(self, stream: RawIOBase | BufferedIOBase) -> None:
        weakref.finalize(self, stream.close)
        self._stream, self._lock = stream, Lock()
        self.size = stream.seek(0, os.SEEK_END)

    @staticmethod
    def at(path: Path) -> "BinaryFile":
        """Open a file for reading.

        Raises
        ------
        InputError
            When it cannot be.
        """
        if path.is_dir():
            raise InputError("is a folder, expected a file")
        try:
            return BinaryFile(path.open("rb", buffering=0))
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror or error}") from error

    def numbers(self, offset: int, kind: np.dtype, shape: tuple[int, ...]) -> np.ndarray:
        """An array that lies at `offset`, its last axis fastest.

        Raises
        ------
        InputError
            When the file ends before it, cannot be read, or memory does not suffice.
        """
        try:
            array = np.empty(shape, kind)
        except MemoryError as error:
            size = prod(shape) * kind.itemsize
            raise InputError(f"{size} bytes of it do not fit in memory at once") from error
        self.fill(array, offset)
        return array

    def fill(self, array: np.ndarray, offset: int) -> None:
        """Read a contiguous array that lies at `offset`.

        Raises
        ------
        InputError
            When the file ends before it, or cannot be read.
        """
        left = array.reshape(-1).view(np.uint8).data
        with self._lock:
            try:
                self._stream.seek(offset)
                while left:
                    count = self._stream.readinto(left)
                    if not count:
                        raise InputError("became shorter since it was opened; run again")
                    left = left[count:]
            except OSError as error:
                raise InputError(f"cannot be read: {error.strerror or error}") from error


@dataclass(frozen=True, slots=True)
class Packing:
    """How an array of positions lies in a file.

    Attributes
    ----------
    offset : int
        First byte.
    kind : dtype
    frames, vertices : int
        F and m.
    order : str
        Axes, the slowest first: f frames, v vertices, x coordinates.
    """

    offset: int
    kind: np.dtype
    frames: int
    vertices: int
    order: str = "fvx"


class StoredFrames:
    """Frames of an array in a file.

    Where the frames are the slowest axis they are read one by one, else in runs.

    Attributes
    ----------
    count : int
        Frames.
    vertices : int
        Vertices of each.
    """

    def __init__(self, file: BinaryFile, packing: Packing) -> None:
        self._file, self._packing = file, packing
        self.count, self.vertices = packing.frames, packing.vertices
        self._frame_bytes = 3 * self.vertices * packing.kind.itemsize
        size = run_size(self.count, self._frame_bytes)
        self._runs = Runs(self._run, self.count, size) if packing.order[2] == "f" else None

    def frame(self, index: int) -> np.ndarray:
        """Positions of one frame, (m, 3).

        Raises
        ------
        InputError
            When it cannot be read.
        """
        if self._runs is not None:
            return self._runs.frame(index)
        packing, inner = self._packing, self._packing.order[1:]
        place = packing.offset + index * self._frame_bytes
        shape = (self.vertices, 3) if inner == "vx" else (3, self.vertices)
        array = self._file.numbers(place, packing.kind, shape)
        return array if inner == "vx" else array.T

    def _run(self, start: int, stop: int) -> np.ndarray:
        """Frames that are the fastest axis: a stretch of each coordinate's row, as (k, m, 3)."""
        packing, rows = self._packing, 3 * self.vertices
        if stop - start == self.count:
            run = self._file.numbers(packing.offset, packing.kind, (rows, self.count))
        else:
            run = np.empty((rows, stop - start), packing.kind)
            for row in range(rows):
                place = packing.offset + (row * self.count + start) * packing.kind.itemsize
                self._file.fill(run[row], place)
        if packing.order == "vxf":
            return run.reshape(self.vertices, 3, -1).transpose(2, 0, 1)
        return run.reshape(3, self.vertices, -1).transpose(2, 1, 0)


def refuse_other_size(file: BinaryFile, expected: int, counts: dict[str, int]) -> None:
    """Refuse counts of a header that are not above zero, or ask for another size of the file.

    Raises
    ------
    InputError
    """
    announced = ", ".join(f"{count} {noun}" for noun, count in counts.items())
    if min(counts.values()) < 1:
        raise InputError(f"announces {announced}, expected one of each at least; export it again")
    if file.size != expected:
        fault = "cut short or damaged" if file.size < expected else "damaged"
        raise InputError(
            f"announces {announced}, which take {expected} bytes, and has {file.size}; it is "
            f"{fault}, export it again"
        )
