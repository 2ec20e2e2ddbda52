"""Frames at known places of a binary file, read when they are asked for."""

import os
import weakref
from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass
from io import BufferedIOBase, RawIOBase
from math import prod
from pathlib import Path
from threading import Lock

import numpy as np

from cageik_cli.util.errors import InputError

LARGEST_RUN = 1 << 25
"""Bytes of a run, unless a frame alone has more."""

KEPT = 2
"""Runs that are kept: threads that read ahead ask for both sides of a border."""


class FramesInRuns(ABC):
    """Frames read in runs, for any thread.

    Parameters
    ----------
    count, vertices : int
        Frames there are, and vertices of each.
    layer : int
        Frames that lie together: a run is as many, or what fits.
    itemsize : int
        Bytes of a coordinate.
    """

    def __init__(self, count: int, vertices: int, layer: int, itemsize: int) -> None:
        self.count, self.vertices = count, vertices
        self._size = max(1, min(layer, LARGEST_RUN // (3 * vertices * itemsize)))
        self._kept: deque[tuple[int, np.ndarray]] = deque()
        self._lock = Lock()

    @abstractmethod
    def run(self, start: int, stop: int) -> np.ndarray:
        """Read frames `start` to `stop`, that left out: (k, m, 3)."""

    def frame(self, index: int) -> np.ndarray:
        """Positions of one frame, (m, 3).

        Raises
        ------
        InputError
            When it cannot be read.
        """
        start = index - index % self._size
        with self._lock:
            run = next((run for first, run in self._kept if first == start), None)
            if run is None:
                if len(self._kept) == KEPT:
                    self._kept.popleft()  # before there is a third
                run = self.run(start, min(start + self._size, self.count))
                self._kept.append((start, run))
        return np.asarray(run[index - start])


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


class StoredFrames(FramesInRuns):
    """Frames of an array in a file, read one by one unless they are its fastest axis."""

    def __init__(self, file: BinaryFile, packing: Packing) -> None:
        self._file, self._packing = file, packing
        self._is_last = packing.order[2] == "f"
        layer = packing.frames if self._is_last else 1
        super().__init__(packing.frames, packing.vertices, layer, packing.kind.itemsize)

    def run(self, start: int, stop: int) -> np.ndarray:
        """Read frames `start` to `stop`, that left out: (k, m, 3)."""
        order = self._packing.order
        lengths = {"f": stop - start, "v": self.vertices, "x": 3}
        stored = self._rows(start, stop) if self._is_last else self._together(start, stop)
        stored = stored.reshape([lengths[axis] for axis in order])
        return stored.transpose([order.index(axis) for axis in "fvx"])

    def _together(self, start: int, stop: int) -> np.ndarray:
        packing, numbers = self._packing, 3 * self.vertices
        place = packing.offset + start * numbers * packing.kind.itemsize
        return self._file.numbers(place, packing.kind, ((stop - start) * numbers,))

    def _rows(self, start: int, stop: int) -> np.ndarray:
        """A stretch of the row that each coordinate has."""
        if stop - start == self.count:
            return self._together(start, stop)
        packing = self._packing
        stretches = np.empty((3 * self.vertices, stop - start), packing.kind)
        for row, stretch in enumerate(stretches):
            place = packing.offset + (row * self.count + start) * packing.kind.itemsize
            self._file.fill(stretch, place)
        return stretches


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
