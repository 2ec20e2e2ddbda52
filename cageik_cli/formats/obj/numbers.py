"""The numbers of an OBJ text, rounded as `float` rounds; compiled where that is possible."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.util import compiled
from cageik_cli.util.arrays import Floats


def convert_words(
    text: bytes, bounds: NDArray[Any], dtype: type[np.float64] | type[np.int64]
) -> NDArray[Any] | None:
    """Convert the words of a text within `bounds`, (w, 2), to (w,); None if one is no number."""
    if compiled.kernel is None:
        return _convert_one_by_one(text, bounds, dtype)
    numbers = np.empty(len(bounds), dtype)
    bounds = np.ascontiguousarray(bounds)
    is_long, has_integers = bounds.dtype == np.int64, dtype is np.int64
    is_number = compiled.kernel.parse_words(text, bounds, is_long, has_integers, numbers)
    return numbers if is_number else None


def _convert_one_by_one(
    text: bytes, bounds: NDArray[Any], dtype: type[np.float64] | type[np.int64]
) -> NDArray[Any] | None:
    """Convert words where nothing is compiled: the reference."""
    steps = np.zeros(len(text) + 1, np.int8)
    steps[bounds[:, 0]] += 1
    steps[bounds[:, 1]] -= 1
    is_inside = np.cumsum(steps[:-1], dtype=np.int8) > 0
    # One split of a text that is blank between the words is quicker than to cut them out.
    blank_between = np.where(is_inside, np.frombuffer(text, np.uint8), np.uint8(ord(" "))).tobytes()
    words = blank_between.split()
    if len(words) != len(bounds) or b"_" in blank_between:
        return None  # Python's digit separator is not a number in a file
    try:
        numbers = np.array(list(map(float if dtype is np.float64 else int, words)), dtype)
    except (ValueError, OverflowError):
        return None
    return None if np.isinf(numbers).any() else numbers


def read_vertex_lines(text: bytes, length: int, count: int) -> Floats | None:
    """Read the `count` vertices, (count, 3), of the first `length` bytes of a text.

    None where nothing is compiled, and for a text that has faces, continued lines, bare returns or
    another number of vertices: `tokens` reads it.
    """
    if compiled.kernel is None:
        return None
    positions = np.empty((count, 3))
    is_read = compiled.kernel.parse_positions(text, length, positions)
    return positions if is_read else None
