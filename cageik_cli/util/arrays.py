"""Types of arrays, how many frames memory holds, and memory that is used again."""

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", bound=np.generic)
Integers = NDArray[np.int64]
Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


DEFAULT_MEMORY = 1 << 30
"""Bytes for weights and frames, where nothing else is asked for."""


def fit_frames(memory: int, vertex_count: int, arrays: int = 1, itemsize: int = 8) -> int:
    """Return how many frames fit in `memory` bytes, at least one.

    A frame takes `arrays` arrays (vertex_count, 3) of items of `itemsize` bytes.
    """
    return max(1, memory // (arrays * 3 * vertex_count * itemsize))


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
