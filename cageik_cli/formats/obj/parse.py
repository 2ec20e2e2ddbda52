"""Wavefront OBJ: positions and faces, in the file's order; nothing merged, split or reordered."""

import codecs

import numpy as np

from cageik_cli.formats.base.mesh_data import FileMesh, check_not_points
from cageik_cli.formats.base.polygons import fan_triangulate_polygons
from cageik_cli.formats.obj.tokens import (
    VERTEX,
    Tokens,
    blank_out,
    parse_polygons,
    parse_vertices,
    tokenize,
)
from cageik_cli.geometry.surface_attributes import fan_triangulate
from cageik_cli.util.errors import FormatError, InputError


def parse_obj(data: bytes) -> FileMesh:
    """Read any OBJ file.

    Raises
    ------
    FormatError
        Naming the line, what it says, and what was expected.
    """
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
    return FileMesh(vertices, fan_triangulate(*polygons), polygons[1])


def _parse_word_by_word(tokens: Tokens, data: bytes) -> FileMesh:
    """Read a text with unusual numbers, or say what is wrong with it."""
    vertices: list[tuple[float, ...]] = []
    polygons: list[list[int]] = []
    for line in np.flatnonzero(tokens.line_kinds).tolist():
        words = tokens.split_line(line)[1:]
        try:
            if tokens.line_kinds[line] == VERTEX:
                vertices.append(_parse_position(words))
            else:
                polygons.append(_parse_polygon(words, len(vertices)))
        except InputError as error:
            raise FormatError(
                f"{_quote_line(tokens, line, data)} {error}; export it again"
            ) from error
    check_not_points(len(vertices), len(polygons))
    if not vertices or not polygons:
        raise FormatError(
            f"{len(vertices)} vertices and {len(polygons)} faces found, expected a mesh in OBJ "
            "text; export it again"
        )
    last = max(map(max, polygons)) + 1
    if last > len(vertices):
        raise FormatError(
            f"a face names vertex {last}, the file has {len(vertices)} (counted from 1); "
            "export it again"
        )
    return FileMesh(np.array(vertices), *fan_triangulate_polygons(polygons))


def _parse_position(words: list[bytes]) -> tuple[float, ...]:
    if len(words) < 3:
        noun = "coordinate" if len(words) == 1 else "coordinates"
        raise FormatError(f"has {len(words)} {noun}, expected 3")
    try:
        x, y, z = (_parse_number(word) for word in words[:3])
    except ValueError as error:
        raise FormatError("has a coordinate that is not a number") from error
    return x, y, z


def _parse_number(word: bytes) -> float:
    if b"_" in word:
        raise ValueError("Python's digit separator is not a number in a file")
    return float(word)


def _parse_polygon(words: list[bytes], count: int) -> list[int]:
    if len(words) < 3:
        raise FormatError(f"has {len(words)} corners, expected 3 or more")
    return [_parse_corner(word, count) for word in words]


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
