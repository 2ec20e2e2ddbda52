"""Types of arrays, and their memory: how many frames it holds, used again, or on the disk."""

import math
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cageik_cli.util.errors import FileAccessError
from cageik_cli.util.messages import say

Number = TypeVar("Number", bound=np.generic)
Integers = NDArray[np.int64]
Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


def count_frames(memory: int, vertex_count: int, arrays: int = 1, itemsize: int = 8) -> int:
    """Return how many frames fit in `memory` bytes, at least one.

    A frame takes `arrays` arrays (vertex_count, 3) of items of `itemsize` bytes.
    """
    return max(1, memory // (arrays * 3 * vertex_count * itemsize))


def spread_evenly(count: int, most: int) -> Integers:
    """Return at most `most` numbers below `count`, ascending; the first and the last are there."""
    return np.rint(np.linspace(0, count - 1, min(count, most))).astype(np.int64)


def cut_blocks(blocks: Iterator[Floats], counts: Sequence[int]) -> Iterator[Iterator[Floats]]:
    """Yield an iterator over each of some numbers of frames, in order; all of one are taken first.

    Blocks are (k, n, 3), of any number of frames.
    """
    left = np.empty((0, 0, 3))

    def take(count: int) -> Iterator[Floats]:
        nonlocal left
        while count:
            block = left if len(left) else next(blocks)
            own, left = block[:count], block[count:]
            count -= len(own)
            yield own

    yield from map(take, counts)


def fill_gaps(block: Floats, start: int, known: Integers, read: Callable[[int], Floats]) -> None:
    """Fill the frames that are not known, in place: linearly between those before and after.

    At either end of the clip, they are as the nearest that is known.

    Parameters
    ----------
    block : (k, n, 3)
        Frames from `start` on.
    known : (f,)
        Numbers of frames, ascending; at least one.
    read : callable
        Returns a known frame, (n, 3).
    """
    for frame in range(start, start + len(block)):
        place = int(np.searchsorted(known, frame))
        before, after = (int(known[np.clip(k, 0, len(known) - 1)]) for k in (place - 1, place))
        if after != frame:
            share = (frame - before) / (after - before) if after > before else 0.0
            block[frame - start] = (1 - share) * read(before) + share * read(after)


class Workspace:
    """Arrays that are used again for each block, so that memory is allocated once.

    New arrays of a block's size cost more in page faults than in arithmetic. Each thread has its
    own workspace.
    """

    def __init__(self) -> None:
        self._arrays: dict[str, Floats] = {}

    def array(self, name: str, *shape: int) -> Floats:
        """Return the array of that name and shape; its content is arbitrary."""
        size = math.prod(shape)
        held = self._arrays.get(name)
        if held is None or held.size < size:
            held = self._arrays[name] = np.empty(size)
        return held[:size].reshape(shape)

    def take_rows(self, name: str, source: Floats, indices: Integers) -> Floats:
        """Return `source[indices]`, copied into the array of that name."""
        out = self.array(name, len(indices), source.shape[1])
        return np.take(source, indices, axis=0, out=out, mode="clip")


def allocate_floats(count: int, memory: int) -> Floats:
    """Return room for numbers: in memory if they fit in so many bytes, else in a temporary file."""
    size = 8 * count
    if size <= memory:
        return np.empty(count)
    folder = tempfile.gettempdir()
    try:
        with tempfile.TemporaryFile(dir=folder) as file:  # it is kept as long as it is mapped
            # Without room behind it, writing to a mapped file would end the process.
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)
            else:
                zeros = bytes(1 << 20)
                for start in range(0, size, len(zeros)):
                    os.write(file.fileno(), zeros[: size - start])
            return np.memmap(file, np.float64, "r+", shape=(count,))
    except OSError as error:
        raise FileAccessError(
            f"{folder}: cannot hold {size >> 20} MiB in a temporary file "
            f"({error.strerror or error}); "
            + say("set TMPDIR to another folder, or raise `memory=`")
        ) from error
