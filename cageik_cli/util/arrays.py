"""Memory that is used again, block after block."""

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", bound=np.generic)
Integers = NDArray[np.int64]
Floats = NDArray[np.float64]


class Workspace:
    """Arrays that are used again block after block, so that memory is asked for once.

    Fresh arrays of a block's size cost more in page faults than in arithmetic. One thread's own.
    """

    def __init__(self) -> None:
        self._arrays: dict[str, Floats] = {}

    def array(self, name: str, *shape: int) -> Floats:
        """The array of that name, of that shape, with anything in it."""
        size = math.prod(shape)
        held = self._arrays.get(name)
        if held is None or held.size < size:
            held = self._arrays[name] = np.empty(size)
        return held[:size].reshape(shape)

    def take_rows(self, name: str, source: Floats, indices: Integers) -> Floats:
        """`source[chosen]` in the array of that name."""
        out = self.array(name, len(indices), source.shape[1])
        return np.take(source, indices, axis=0, out=out, mode="clip")
