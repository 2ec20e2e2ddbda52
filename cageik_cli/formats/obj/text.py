"""The words of an OBJ text, found all at once; reading, comparing and rewriting share them.

Words are found in a text of the same length without comments and without line ends that a backslash
continues (`blank_out`), so that every place in it is a place in the file. Numbers are rounded as
`float` rounds, by compiled code where that is possible.
"""

import codecs
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.util import compiled
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError, InputError
from cageik_cli.util.text import format_count, group_digits

Offsets = NDArray[np.int32] | NDArray[np.int64]

VERTEX, FACE = ord("v"), ord("f")

_IS_BLANK = np.isin(np.arange(256), list(b" \t\n\r\v\f"))

_BARE_RETURN = re.compile(rb"\r(?!\n)")

MAX_SHORT_TEXT = 2**31 - 1
"""Bytes of a text whose places 32 bits can count."""


@dataclass(frozen=True, slots=True, eq=False)
class Tokens:
    """Where the words of a text are.

    Attributes
    ----------
    text : bytes
        As `blank_out` makes it, with a newline at its end and no other line ends.
    bounds : (w, 2) int32 or int64
        Where each word begins and ends, in bytes.
    first_tokens : (l,) int64
        Number of the first word of each line that has any.
    line_kinds : (l,) uint8
        `VERTEX` or `FACE` where that word is `v` or `f`, else 0.
    """

    text: bytes
    bounds: Offsets
    first_tokens: Integers
    line_kinds: NDArray[np.uint8]

    @property
    def codes(self) -> NDArray[np.uint8]:
        """The text as numbers."""
        return np.frombuffer(self.text, np.uint8)

    @property
    def token_counts(self) -> Integers:
        """Words of each line, (l,)."""
        return np.diff(self.first_tokens, append=len(self.bounds))

    def split_line(self, line: int) -> list[bytes]:
        """Return the words of a line."""
        start, *after = self.first_tokens[line : line + 2].tolist()
        bounds = self.bounds[start : after[0] if after else None].tolist()
        return [self.text[begin:end] for begin, end in bounds]

    def find_lines(self, keyword: bytes) -> NDArray[np.bool_]:
        """Find the lines that begin with a word, (l,)."""
        begins, ends = self.bounds[self.first_tokens].T
        found = np.asarray(ends - begins == len(keyword))
        for k, letter in enumerate(keyword):
            found[found] = self.codes[begins[found] + k] == letter
        return found

    def find_part(self, bounds: Offsets, place: int) -> Offsets:
        """Return where part `place` of each word begins and ends, cut at slashes, (k, 2).

        A part that a word does not have is empty.
        """
        slashes = np.append(np.flatnonzero(self.codes == ord("/")), len(self.text))
        if len(slashes) == 1 and place == 0:
            return bounds
        next_slash = np.searchsorted(slashes, bounds[:, 0])
        parts = bounds.copy()
        if place > 0:
            before = slashes[np.minimum(next_slash + place - 1, len(slashes) - 1)]
            parts[:, 0] = np.minimum(before + 1, bounds[:, 1])
        after = slashes[np.minimum(next_slash + place, len(slashes) - 1)]
        parts[:, 1] = np.minimum(after, bounds[:, 1])
        return parts

    def line_bounds(self, lines: NDArray[Any]) -> Integers:
        """Return where lines begin, and where they end behind their newline, (k, 2)."""
        ends = np.flatnonzero(self.codes == ord("\n")) + 1
        line = np.searchsorted(ends, self.bounds[self.first_tokens[lines], 0], side="right")
        return np.stack([np.concatenate([[0], ends])[line], ends[line]], axis=1)


def blank_out(data: bytes) -> bytes:
    """Return a text without comments and continued line ends, as long as it was.

    Blanks take their places; but a line that is nothing but a comment becomes one word.
    """
    if b"#" in data:
        data = _blank_out_comments(data)
    if b"\\" in data:
        data = re.sub(rb"\\(?:\r\n?|\n|\Z)", lambda found: b" " * len(found[0]), data)
    return data


def _blank_out_comments(data: bytes) -> bytes:
    # Most files have one comment or none: a search is ten times as quick as an expression.
    text, has_returns, may_continue = bytearray(data), b"\r" in data, b"\\" in data
    begin = data.find(b"#")
    while begin >= 0:
        end = data.find(b"\n", begin)
        end = len(data) if end < 0 else end
        if has_returns:
            first = data.find(b"\r", begin, end)
            if 0 <= first < end - 1:
                # It ends the line. In a text of such lines, each search for the next newline would
                # go to the end of the text.
                return _blank_out_comments(_BARE_RETURN.sub(b"\n", data))
            end = end if first < 0 else first
        # Long gaps are slow. Behind a backslash it might be no line of its own.
        is_line = not may_continue and data[begin - 1 : begin] in (b"", b"\n", b"\r")
        text[begin:end] = (b"#" if is_line else b" ") * (end - begin)
        begin = data.find(b"#", end)
    return bytes(text)


def tokenize(text: bytes) -> Tokens:
    """Find the words of a text without comments and continued lines, see `blank_out`."""
    text = text if text.endswith(b"\n") else text + b"\n"
    codes = np.frombuffer(text, np.uint8)
    ends = np.flatnonzero(codes <= ord(" "))
    gaps = codes[ends]
    if (codes[ends[gaps == ord("\r")] + 1] != ord("\n")).any():
        return tokenize(_BARE_RETURN.sub(b"\n", text))
    # 9 to 13, and the blank itself; below 9 unsigned numbers wrap.
    if ((gaps - ord("\t") > 4) & (gaps != ord(" "))).any():
        # Control bytes are parts of words, unlike the blanks.
        controls = np.flatnonzero(~_IS_BLANK[: ord(" ")]).astype(np.uint8).tobytes()
        return tokenize(text.translate(bytes.maketrans(controls, b"?" * len(controls))))
    bounds = np.empty((len(ends), 2), np.int32 if len(text) <= MAX_SHORT_TEXT else np.int64)
    bounds[0, 0], bounds[1:, 0], bounds[:, 1] = 0, ends[:-1] + 1, ends
    is_head = np.empty(len(ends), bool)
    is_head[0], is_head[1:] = True, gaps[:-1] == ord("\n")
    is_word = bounds[:, 1] > bounds[:, 0]
    if not is_word.all():
        lines = np.cumsum(is_head)[is_word]
        bounds, is_head = bounds[is_word], np.diff(lines, prepend=0) > 0
    heads = np.flatnonzero(is_head)
    # What a line is: its first word, if that is `v` or `f` alone.
    begins = bounds[heads, 0]
    letters = codes[begins]
    letters[((letters != VERTEX) & (letters != FACE)) | ~_IS_BLANK[codes[begins + 1]]] = 0
    return Tokens(text, bounds, heads, letters)


def parse_vertices(tokens: Tokens) -> Floats | None:
    """Convert the first three numbers of every `v` line, (n, 3).

    None if there is no such line, or one does not begin with three numbers, or one is infinite.
    """
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
    values = convert_words(tokens.text, bounds.reshape(-1, 2), np.float64)
    return None if values is None else values.reshape(-1, 3)


def parse_polygons(tokens: Tokens) -> tuple[Integers, Integers] | None:
    """Convert the corners of every `f` line, from 0, one after the other; and how many each has.

    None if there is no such line, a face lacks corners, or names no vertex of the text.
    """
    is_face, sizes = tokens.line_kinds == FACE, tokens.token_counts
    is_corner = np.repeat(is_face, sizes)
    is_corner[tokens.first_tokens] = False
    counts = sizes[is_face] - 1
    bounds = tokens.find_part(tokens.bounds[is_corner], 0)
    values = convert_words(tokens.text, bounds, np.int64)
    if values is None or len(counts) == 0 or counts.min() < 3 or (values == 0).any():
        return None
    known = np.cumsum(tokens.line_kinds == VERTEX)[is_face]
    corners = np.where(values > 0, values - 1, values + np.repeat(known, counts))
    is_there = (corners >= 0) & (corners < np.count_nonzero(tokens.line_kinds == VERTEX))
    return (corners, counts) if is_there.all() else None


def leave_out_short_faces(data: bytes) -> tuple[bytes, int]:
    """Return a text without its faces of fewer than three corners, and how many there are.

    One that the text ends in, without the end of its line, stays: the file is cut off there.
    Numbers in others stay what they are, and so do the places of all other lines.
    """
    words = tokenize(blank_out(data))
    is_short = (words.line_kinds == FACE) & (words.token_counts < 4)
    if len(is_short) and not data.endswith((b"\n", b"\r")):
        is_short[-1] = False
    lines = np.flatnonzero(is_short)
    text = bytearray(words.text)
    for begin, end in words.line_bounds(lines).tolist() if len(lines) else ():
        text[begin : end - 1] = b"#" * (end - 1 - begin)
    return (bytes(text), len(lines)) if len(lines) else (data, 0)


def parse_obj(data: bytes) -> FileMesh:
    """Read any OBJ file; one with faces of fewer than three corners is refused."""
    data = data.removeprefix(codecs.BOM_UTF8)
    if not data.strip():
        raise FormatError("the file is empty, expected an OBJ mesh; export it again")
    if b"\0" in data:
        raise FormatError("the file is binary, expected OBJ text; export it again")
    words = tokenize(blank_out(data))
    vertices = parse_vertices(words)
    polygons = parse_polygons(words) if vertices is not None else None
    if vertices is None or polygons is None:
        return _parse_word_by_word(words, data)
    return FileMesh(vertices, *polygons)


def _parse_word_by_word(tokens: Tokens, data: bytes) -> FileMesh:
    """Read a text with unusual numbers, or say what is wrong with it."""
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    for line in np.flatnonzero(tokens.line_kinds).tolist():
        words, is_vertex = tokens.split_line(line)[1:], tokens.line_kinds[line] == VERTEX
        try:
            if len(words) < 3:
                found = format_count(len(words), "coordinate" if is_vertex else "corner")
                raise FormatError(f"has {found}, expected {'3' if is_vertex else '3 or more'}")
            if is_vertex:
                vertices.append([_parse_coordinate(word) for word in words[:3]])
            else:
                polygons.append([_parse_corner(word, len(vertices)) for word in words])
        except InputError as error:
            is_last = not tokens.line_kinds[line + 1 :].any()
            is_cut = is_last and not data.endswith((b"\n", b"\r"))
            remedy = "the file is cut off there, export it again" if is_cut else "export it again"
            raise FormatError(f"{_quote_line(tokens, line, data)} {error}; {remedy}") from error
    if not vertices:
        raise FormatError(
            f"0 vertices and {group_digits(len(polygons))} faces found, expected a mesh in OBJ "
            "text; export it "
            "again"
        )
    last = max(map(max, polygons), default=0) + 1
    if last > len(vertices):
        raise FormatError(
            f"a face names vertex {last}, the file has {len(vertices)} (counted from 1); "
            "export it again"
        )
    return FileMesh.from_polygons(np.array(vertices), polygons)


def _parse_coordinate(word: bytes) -> float:
    try:
        # Python's digit separator is not a number in a file.
        return float(word.replace(b"_", b"?"))
    except ValueError as error:
        raise FormatError("has a coordinate that is not a number") from error


def _parse_corner(word: bytes, count: int) -> int:
    """Return the vertex, from 0, of `v`, `v/vt`, `v/vt/vn` or `v//vn`; negative counts back."""
    try:
        index = int(word.split(b"/", 1)[0])
    except ValueError as error:
        raise FormatError("has a corner that is not a number") from error
    vertex = index - 1 if index > 0 else count + index
    if index == 0 or vertex < 0:
        raise FormatError(f"names vertex {index}, but vertices are counted from 1")
    return vertex


def _quote_line(tokens: Tokens, line: int, data: bytes) -> str:
    """Return the number of a line, from 1, and its text in the file."""
    begin, end = tokens.line_bounds(np.array([line]))[0]
    number = len(data[:begin].splitlines()) + 1
    text = " ".join(data[begin:end].decode("ascii", errors="replace").split())
    return f"line {number}: `{text if len(text) <= 60 else text[:57] + '...'}`"


def convert_words(
    text: bytes, bounds: NDArray[Any], dtype: type[np.float64] | type[np.int64]
) -> NDArray[Any] | None:
    """Convert the words of a text within `bounds`, (w, 2), to (w,); None if one is no number."""
    if compiled.kernel is None:
        return _convert_in_python(text, bounds, dtype)
    numbers = np.empty(len(bounds), dtype)
    bounds = np.ascontiguousarray(bounds)
    is_long, has_integers = bounds.dtype == np.int64, dtype is np.int64
    is_number = compiled.kernel.parse_words(text, bounds, is_long, has_integers, numbers)
    return numbers if is_number else None


def _convert_in_python(
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
