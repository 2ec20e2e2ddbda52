"""Object File Format (OFF): positions and polygons, in the file's order; read only.

A row has a vertex or a face as a rule, but numbers may be on any lines. So a text is read row by
row first, and number by number where that gives no mesh.
"""

import codecs
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import accumulate, chain, islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.files import with_gzip
from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.formats.base.readers import FrameFileReader
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError
from cageik_cli.util.text import group_digits, single_line

MAX_QUOTED_LETTERS = 40
"""Letters of a word or a row that a message quotes, at most."""

Rows = list[list[str]]


class Reader(FrameFileReader):
    """Frames from OFF files."""

    suffixes = with_gzip(".off")

    @classmethod
    def parse(cls, data: bytes) -> FileMesh:
        """Parse the content of an OFF file."""
        return FileMesh.from_polygons(*parse_off(data))


def parse_off(data: bytes) -> tuple[Floats, list[Integers]]:
    """Read the vertices (n, 3) and the corners of each face of an OFF text.

    What follows the position of a vertex (colour, normal, texture), or the corners of a face on its
    row, is passed over. The keyword may be glued to the first number, or missing.
    """
    try:
        # Names in comments are in any encoding.
        text = data.removeprefix(codecs.BOM_UTF8).decode("latin-1")
        text = re.sub(r"#[^\r\n]*", "", text).strip()
        # The letters before are of texture coordinates, colours and normals.
        keyword = re.match(r"(ST)?(C)?(N)?(4)?(n)?OFF(?![A-Za-z])\s*(BINARY)?", text)
        if keyword is None and not re.match(r"\d", text):
            raise FormatError("it does not begin with OFF")
        if keyword and (keyword[4] or keyword[5] or keyword[6]):
            raise FormatError("it is binary, or of another number of dimensions than three")
        rows = [row.split() for row in text[keyword.end() if keyword else 0 :].splitlines()]
        return _parse_rows(list(filter(None, rows)), keyword)
    except FormatError as error:
        raise FormatError(f"is not a sound OFF mesh ({error}); export it again") from error


def _parse_rows(rows: Rows, keyword: re.Match[str] | None) -> tuple[Floats, list[Integers]]:
    """Read the rows behind the keyword, in the first way that gives a mesh."""
    count, faces, rests = _read_counts(rows)
    for rest in rests:
        for vertices, behind in _cut_vertices(rest, count, keyword):
            for read_faces in (_read_face_rows, _read_loose_faces):
                with suppress(FormatError):
                    return _join(vertices, read_faces(behind, faces), count, faces)
    return _join(rests[0][:count], _read_face_rows(rests[0][count:], faces), count, faces)


def _read_counts(rows: Rows) -> tuple[int, int, list[Rows]]:
    """Return how many vertices and faces there are, and what may be the rows of these.

    A third number, of edges, may be missing; and what else is on that row may be more of it.
    """
    taken = 0
    words: list[str] = []
    while len(words) < 2 and taken < len(rows):
        words += rows[taken]
        taken += 1
    if len(words) == 2 and taken < len(rows) and len(rows[taken]) == 1:
        taken += 1
    if len(words) < 2:
        raise FormatError("it does not say how many vertices and faces it has")
    count, faces = _to_numbers(words[:2], np.int64).tolist()
    if min(count, faces) < 0:
        raise FormatError(
            f"it announces {group_digits(count)} vertices and {group_digits(faces)} faces"
        )
    rest = rows[taken:]
    return count, faces, [rest, [words[3:], *rest]] if len(words) > 3 else [rest]


def _cut_vertices(
    rows: Rows, count: int, keyword: re.Match[str] | None
) -> Iterator[tuple[Rows, Rows]]:
    """Yield the ways to cut rows into those of `count` vertices, and those of faces.

    They are a row each if all rows have as many numbers; else they may be on any rows, which end
    where the last of them does as a rule.
    """
    if len({len(row) for row in rows[:count]}) == 1:
        yield rows[:count], rows[count:]
    own = 3 + (2 if keyword and keyword[1] else 0) + (3 if keyword and keyword[3] else 0)
    widths = [own + colour for colour in ((4, 3, 0) if keyword and keyword[2] else (0,))]
    ends = list(accumulate(map(len, rows)))
    for width in widths:
        if count * width in ends:
            stop = ends.index(count * width) + 1
            flat = list(chain.from_iterable(rows[:stop]))
            yield [flat[k : k + width] for k in range(0, len(flat), width)], rows[stop:]
    yield rows[:count], rows[count:]
    flat = list(chain.from_iterable(rows))
    for width in widths:
        stop = min(count * width, len(flat))
        yield (
            [flat[k : k + width] for k in range(0, stop, width)],
            [flat[stop:]] if len(flat) > stop else [],
        )


def _join(
    rows: Rows, polygons: list[Integers], count: int, faces: int
) -> tuple[Floats, list[Integers]]:
    """Return the vertices of rows, and polygons; refuse others than are announced."""
    if (len(rows), len(polygons)) != (count, faces):
        raise FormatError(
            f"it announces {group_digits(count)} vertices and {group_digits(faces)} faces, but "
            f"holds {group_digits(len(rows))} and "
            f"{len(polygons)}"
        )
    short = next((row for row in rows if len(row) < 3), None)
    if short is not None:
        raise FormatError(f"the vertex `{_quote(short)}` has {len(short)} numbers, expected 3")
    words = [word for row in rows for word in row[:3]]
    return _to_numbers(words, np.float64).reshape(-1, 3), polygons


def _read_face_rows(rows: Rows, count: int) -> list[Integers]:
    """Read faces that each begin a row; what is behind their corners may be a colour."""
    polygons: list[Integers] = []
    waiting = iter(rows)
    for row in islice(waiting, count):
        words = row
        size = int(_to_numbers(words[:1], np.int64)[0])
        while len(words) <= size:
            more = next(waiting, None)
            if more is None:
                raise FormatError(f"the face `{_quote(row)}` lacks corners")
            words = words + more
        polygons.append(_to_numbers(words[1 : max(size, 0) + 1], np.int64))
    return polygons


def _read_loose_faces(rows: Rows, count: int) -> list[Integers]:
    """Read faces that may be on any rows, and have nothing behind their corners."""
    numbers = _to_numbers(list(chain.from_iterable(rows)), np.int64)
    polygons, place = list[Integers](), 0
    while place < len(numbers) and len(polygons) < count:
        size = int(numbers[place])
        polygons.append(numbers[place + 1 : place + 1 + size])
        if size < 1 or len(polygons[-1]) < size:
            raise FormatError(f"a face of {size} corners has no such number of them")
        place += size + 1
    if place < len(numbers):
        raise FormatError(f"{len(numbers) - place} numbers are behind the last face")
    return polygons


def _to_numbers(words: Sequence[str], kind: type[np.float64 | np.int64]) -> NDArray[Any]:
    """Convert words; refuse the first that is no number of the kind."""
    try:
        return np.array(words, kind)
    except (ValueError, OverflowError):
        pattern = r"[+-]?\d{1,18}" if kind is np.int64 else _OFF_NUMBER
        wrong = next((word for word in words if not re.fullmatch(pattern, word)), words[0])
        expected = "a whole number" if kind is np.int64 else "a number"
        raise FormatError(f"`{_quote([wrong])}` is not {expected}") from None


_OFF_NUMBER = r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)"


def _quote(words: Sequence[str]) -> str:
    text = single_line(" ".join(words))
    return text if len(text) <= MAX_QUOTED_LETTERS else text[: MAX_QUOTED_LETTERS - 3] + "..."
