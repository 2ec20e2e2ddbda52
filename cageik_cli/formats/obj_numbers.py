"""The numbers of an OBJ text, rounded as `float` rounds; compiled where that is possible."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.util import compiled
from cageik_cli.util.arrays import Floats

MAX_PLAIN_LENGTH = 18
"""Characters of words that are converted all at once; their digits fit in 64 bits."""


def convert_words(
    text: bytes, bounds: NDArray[Any], dtype: type[np.float64] | type[np.int64]
) -> NDArray[Any] | None:
    """Convert the words of a text within `bounds`, (w, 2), to (w,); None if one is no number."""
    if compiled.kernel is None:
        convert = _convert_decimals if dtype is np.float64 else _convert_one_by_one
        return convert(text, bounds, dtype)
    numbers = np.empty(len(bounds), dtype)
    bounds = np.ascontiguousarray(bounds)
    is_long, has_integers = bounds.dtype == np.int64, dtype is np.int64
    is_number = compiled.kernel.parse_words(text, bounds, is_long, has_integers, numbers)
    return numbers if is_number else None


def _convert_decimals(
    text: bytes, bounds: NDArray[Any], dtype: type[np.float64] | type[np.int64]
) -> NDArray[Any] | None:
    """Convert words where nothing is compiled, those that are short plain decimals all at once.

    Their digits and the power of ten are exact, and the quotient rounds once (Clinger 1990).
    """
    begins, lengths = bounds[:, 0], bounds[:, 1] - bounds[:, 0]
    codes = np.frombuffer(text + bytes(MAX_PLAIN_LENGTH), np.uint8)
    width = min(int(lengths.max(initial=0)), MAX_PLAIN_LENGTH)
    digits, points, places, counts = np.zeros((4, len(bounds)), np.int64)
    is_plain = lengths <= width
    for k in range(width):
        code, is_part = codes[begins + k], k < lengths
        is_digit = is_part & (code - np.uint8(ord("0")) < 10)
        is_point = is_part & (code == ord("."))
        is_sign = (k == 0) & ((code == ord("-")) | (code == ord("+")))
        is_plain &= ~is_part | is_digit | is_point | is_sign
        digits = np.where(is_digit, 10 * digits + code % 16, digits)
        points += is_point
        places += is_digit & (points > 0)
        counts += is_digit
    is_plain &= (points <= 1) & (counts > 0) & (digits <= 2**53)
    powers = np.array([float(f"1e{power}") for power in range(MAX_PLAIN_LENGTH + 1)])
    numbers = np.asarray(digits / powers[places] * np.where(codes[begins] == ord("-"), -1.0, 1.0))
    others = _convert_one_by_one(text, bounds[~is_plain], dtype)
    if others is None:
        return None
    numbers[~is_plain] = others
    return numbers


def _convert_one_by_one(
    text: bytes, bounds: NDArray[Any], dtype: type[np.float64] | type[np.int64]
) -> NDArray[Any] | None:
    """Convert words by Python's own functions."""
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
