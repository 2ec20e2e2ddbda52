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
_LONGEST = 2**31 - 1  # Arrow's strings count their bytes in 32 bits


@dataclass(frozen=True, slots=True, eq=False)
class Words:
    """Where the words of a text stand.

    Attributes
    ----------
    data : bytes
        The text, with a newline at its end.
    bounds : (w, 2) int32
        Where each begins and ends, in bytes.
    heads : (l,) int64
        Number of the first word of each line that has any.
    kinds : (l,) uint8
        `VERTEX` or `FACE` where that word is `v` or `f`, else 0: the line does not matter.
    """

    data: bytes
    bounds: Offsets
    heads: Integers
    kinds: NDArray[np.uint8]

    @property
    def sizes(self) -> Integers:
        """Words of each line, (l,)."""
        return np.diff(self.heads, append=len(self.bounds))


def words_of(data: bytes, parts: bool = False) -> Words | None:
    """Find the words of a text; of `parts`, those that slashes divide them into.

    None if a byte is neither blank nor printed, a line ends in a backslash or in a bare CR, or
    `v` or `f` is followed by a comment.
    """
    data = data if data.endswith(b"\n") else data + b"\n"
    if len(data) > _LONGEST or (b"\\" in data and (b"\\\n" in data or b"\\\r" in data)):
        return None
    codes = np.frombuffer(data, np.uint8)
    is_gap = codes <= ord(" ")
    if parts:
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
    kinds = _kinds(codes, bounds[heads, 0])
    return None if kinds is None else Words(data, bounds, heads, kinds)


def vertices_of(words: Words) -> Floats | None:
    """The first three numbers of every `v` line, (n, 3), all finite; None if there is none."""
    chosen = words.kinds == VERTEX
    sizes, heads = words.sizes[chosen], words.heads[chosen]
    if not len(heads) or sizes.min() < 4:
        return None
    if (sizes == sizes[0]).all() and heads[-1] - heads[0] == sizes[:-1].sum():
        # One block of lines of as many words: a slice is quicker than picking them.
        block = slice(heads[0], heads[-1] + sizes[0])
        bounds = words.bounds[block].reshape(-1, sizes[0], 2)[:, 1:4]
    else:
        bounds = words.bounds[heads[:, None] + np.arange(1, 4)]
    values = _converted(words.data, bounds, np.float64)
    if values is None or not np.isfinite(values).all():
        return None
    return values.reshape(-1, 3)


def polygons_of(parts: Words) -> tuple[Integers, Integers] | None:
    """Corners of every `f` line, from 0, one after the other, and how many each has.

    None if there is none, a face lacks corners, has a comment, or names no vertex of the text.
    """
    sizes = parts.sizes
    is_corner = np.repeat(parts.kinds == FACE, sizes)
    is_corner[parts.heads] = False
    codes = np.frombuffer(parts.data, np.uint8)
    # A comment may begin inside a corner, behind what is read of it.
    marks = np.flatnonzero(codes == ord("#"))
    lines = np.searchsorted(parts.bounds[parts.heads, 0], marks, side="right") - 1
    if (parts.kinds[lines] == FACE).any():
        return None
    is_corner &= codes[parts.bounds[:, 0] - 1] != _SLASH
    bounds = parts.bounds[is_corner]
    # Arrow reads hexadecimal integers, Python does not.
    if np.isin(codes[bounds[:, 0] + 1], list(b"xX")).any():
        return None
    counts = np.add.reduceat(is_corner, parts.heads, dtype=np.int64)[parts.kinds == FACE]
    values = _converted(parts.data, bounds, np.int64)
    if values is None or counts.min() < 3 or (values == 0).any():
        return None
    known = np.cumsum(parts.kinds == VERTEX)[parts.kinds == FACE]
    corners = np.where(values > 0, values - 1, values + np.repeat(known, counts))
    is_there = (corners >= 0) & (corners < np.count_nonzero(parts.kinds == VERTEX))
    return (corners, counts) if is_there.all() else None


def _kinds(codes: NDArray[np.uint8], begins: Integers) -> NDArray[np.uint8] | None:
    """What the lines are that begin with the words at `begins`; None if it takes a closer look."""
    letters, next_to = codes[begins], codes[begins + 1]
    letters[(letters != VERTEX) & (letters != FACE)] = 0
    if ((letters != 0) & (next_to == ord("#"))).any():
        return None
    letters[~_IS_BLANK[next_to]] = 0
    return letters


def _converted(data: bytes, bounds: Offsets, kind: type[np.generic]) -> NDArray[Any] | None:
    """The words within `bounds` as numbers, rounded as `float` rounds; None if one is none."""
    if not bounds.size:
        return None
    # Strings that touch, as Arrow has them: words, and between them what counts as missing.
    count = bounds.size - 1
    is_word = np.full(count // 8 + 1, 0b01010101, np.uint8)
    buffers = [pyarrow.py_buffer(part) for part in (is_word, np.ascontiguousarray(bounds), data)]
    strings = pyarrow.Array.from_buffers(pyarrow.string(), count, buffers)
    batch = pyarrow.record_batch([strings], ["number"])
    wanted = pyarrow.schema([("number", pyarrow.from_numpy_dtype(kind))])
    # A reader casts as `pyarrow.compute` does, which takes 50 ms to import.
    reader = pyarrow.RecordBatchReader.from_batches(batch.schema, [batch]).cast(wanted)
    try:
        numbers = reader.read_next_batch().column(0)
    except pyarrow.ArrowInvalid:
        return None
    # Out of the buffer, for pyarrow's own conversion imports pandas where it is installed.
    return np.frombuffer(numbers.buffers()[1], kind, count)[::2].copy()
