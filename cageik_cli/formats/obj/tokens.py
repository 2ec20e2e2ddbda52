"""The words of an OBJ text, all found and converted at once; what is not regular is declined.

To decline is to return None: `obj.parse_obj` then goes through the text line by line. What is not
declined is what that gives, to the bit.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow
from numpy.typing import NDArray

from cageik_cli.util.arrays import Floats, Integers

Offsets = NDArray[np.int32]
VERTEX, FACE = ord("v"), ord("f")
_SLASH, _NEWLINE, _RETURN = b"/\n\r"
_IS_BLANK = np.isin(np.arange(256), list(b" \t\n\r\v\f"))
_MAX_TEXT_BYTES = 2**31 - 1  # Arrow's strings count their bytes in 32 bits


@dataclass(frozen=True, slots=True, eq=False)
class Tokens:
    """Where the words of a text stand.

    Attributes
    ----------
    data : bytes
        The text, with a newline at its end.
    bounds : (w, 2) int32
        Where each begins and ends, in bytes.
    first_tokens : (l,) int64
        Number of the first word of each line that has any.
    line_kinds : (l,) uint8
        `VERTEX` or `FACE` where that word is `v` or `f`, else 0: the line does not matter.
    """

    data: bytes
    bounds: Offsets
    first_tokens: Integers
    line_kinds: NDArray[np.uint8]

    @property
    def token_counts(self) -> Integers:
        """Words of each line, (l,)."""
        return np.diff(self.first_tokens, append=len(self.bounds))


def tokenize(data: bytes, split_slashes: bool = False) -> Tokens | None:
    """Find the words of a text; of `split_slashes`, those that slashes divide them into.

    None if a byte is neither blank nor printed, a line ends in a backslash or in a bare CR, or
    `v` or `f` is followed by a comment.
    """
    data = data if data.endswith(b"\n") else data + b"\n"
    if len(data) > _MAX_TEXT_BYTES or (b"\\" in data and (b"\\\n" in data or b"\\\r" in data)):
        return None
    codes = np.frombuffer(data, np.uint8)
    is_gap = codes <= ord(" ")
    if split_slashes:
        is_gap |= codes == _SLASH
    ends = np.flatnonzero(is_gap)
    gaps = codes[ends]
    # 9 to 13, and the blank itself; below 9 unsigned numbers wrap.
    if ((gaps - ord("\t") > 4) & (gaps != ord(" ")) & (gaps != _SLASH)).any():
        return None
    if (codes[ends[gaps == _RETURN] + 1] != _NEWLINE).any():
        return None
    bounds = np.empty((len(ends), 2), np.int32)
    bounds[0, 0], bounds[1:, 0], bounds[:, 1] = 0, ends[:-1] + 1, ends
    is_head = np.empty(len(ends), bool)
    is_head[0], is_head[1:] = True, gaps[:-1] == _NEWLINE
    # What stands before a slash is a part, even of no length.
    is_word = (bounds[:, 1] > bounds[:, 0]) | (gaps == _SLASH)
    if not is_word.all():
        lines = np.cumsum(is_head)[is_word]
        bounds, is_head = bounds[is_word], np.diff(lines, prepend=0) > 0
    heads = np.flatnonzero(is_head)
    kinds = _classify_lines(codes, bounds[heads, 0])
    return None if kinds is None else Tokens(data, bounds, heads, kinds)


def parse_vertices(tokens: Tokens) -> Floats | None:
    """The first three numbers of every `v` line, (n, 3), all finite; None if there is none."""
    chosen = tokens.line_kinds == VERTEX
    sizes, heads = tokens.token_counts[chosen], tokens.first_tokens[chosen]
    if not len(heads) or sizes.min() < 4:
        return None
    if (sizes == sizes[0]).all() and heads[-1] - heads[0] == sizes[:-1].sum():
        # One block of lines of as many words: a slice is quicker than picking them.
        block = slice(heads[0], heads[-1] + sizes[0])
        bounds = tokens.bounds[block].reshape(-1, sizes[0], 2)[:, 1:4]
    else:
        bounds = tokens.bounds[heads[:, None] + np.arange(1, 4)]
    values = _convert_numbers(tokens.data, bounds, np.float64)
    if values is None or not np.isfinite(values).all():
        return None
    return values.reshape(-1, 3)


def parse_polygons(tokens: Tokens) -> tuple[Integers, Integers] | None:
    """Corners of every `f` line, from 0, one after the other, and how many each has.

    None if there is none, a face lacks corners, has a comment, or names no vertex of the text.
    """
    sizes = tokens.token_counts
    is_corner = np.repeat(tokens.line_kinds == FACE, sizes)
    is_corner[tokens.first_tokens] = False
    codes = np.frombuffer(tokens.data, np.uint8)
    # A comment may begin inside a corner, behind what is read of it.
    marks = np.flatnonzero(codes == ord("#"))
    lines = np.searchsorted(tokens.bounds[tokens.first_tokens, 0], marks, side="right") - 1
    if (tokens.line_kinds[lines] == FACE).any():
        return None
    is_corner &= codes[tokens.bounds[:, 0] - 1] != _SLASH
    bounds = tokens.bounds[is_corner]
    # Arrow reads hexadecimal integers, Python does not.
    if np.isin(codes[bounds[:, 0] + 1], list(b"xX")).any():
        return None
    counts = np.add.reduceat(is_corner, tokens.first_tokens, dtype=np.int64)[
        tokens.line_kinds == FACE
    ]
    values = _convert_numbers(tokens.data, bounds, np.int64)
    if values is None or counts.min() < 3 or (values == 0).any():
        return None
    known = np.cumsum(tokens.line_kinds == VERTEX)[tokens.line_kinds == FACE]
    corners = np.where(values > 0, values - 1, values + np.repeat(known, counts))
    is_there = (corners >= 0) & (corners < np.count_nonzero(tokens.line_kinds == VERTEX))
    return (corners, counts) if is_there.all() else None


def _classify_lines(codes: NDArray[np.uint8], begins: Integers) -> NDArray[np.uint8] | None:
    """What the lines are that begin with the words at `begins`; None if it takes a closer look."""
    letters, next_to = codes[begins], codes[begins + 1]
    letters[(letters != VERTEX) & (letters != FACE)] = 0
    if ((letters != 0) & (next_to == ord("#"))).any():
        return None
    letters[~_IS_BLANK[next_to]] = 0
    return letters


def _convert_numbers(data: bytes, bounds: Offsets, dtype: type[np.generic]) -> NDArray[Any] | None:
    """The words within `bounds` as numbers, rounded as `float` rounds; None if one is none."""
    if not bounds.size:
        return None
    # Strings that touch, as Arrow has them: words, and between them what counts as missing.
    count = bounds.size - 1
    is_word = np.full(count // 8 + 1, 0b01010101, np.uint8)
    buffers = [pyarrow.py_buffer(part) for part in (is_word, np.ascontiguousarray(bounds), data)]
    strings = pyarrow.Array.from_buffers(pyarrow.string(), count, buffers)
    batch = pyarrow.record_batch([strings], ["number"])
    wanted = pyarrow.schema([("number", pyarrow.from_numpy_dtype(dtype))])
    # A reader casts as `pyarrow.compute` does, which takes 50 ms to import.
    reader = pyarrow.RecordBatchReader.from_batches(batch.schema, [batch]).cast(wanted)
    try:
        numbers = reader.read_next_batch().column(0)
    except pyarrow.ArrowInvalid:
        return None
    # Out of the buffer, for pyarrow's own conversion imports pandas where it is installed.
    return np.frombuffer(numbers.buffers()[1], dtype, count)[::2].copy()
