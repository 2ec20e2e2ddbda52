"""Wavefront OBJ: positions and faces, in the file's order; nothing merged, split or reordered."""

import codecs
from collections.abc import Iterator

import numpy as np

from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.formats.base.polygons import fan_triangulate, fan_triangulate_polygons
from cageik_cli.formats.obj.tokens import parse_polygons, parse_vertices, tokenize
from cageik_cli.util.errors import InputError


def parse_obj(data: bytes) -> FileMesh:
    """Read any OBJ file.

    Raises
    ------
    InputError
        Naming the line, what it says, and what was expected.
    """
    data = data.removeprefix(codecs.BOM_UTF8)
    if not data.strip():
        raise InputError("the file is empty, expected an OBJ mesh; export it again")
    if b"\0" in data:
        raise InputError("the file is binary, expected OBJ text; export it again")
    return _parse_whole_text(data) or _parse_line_by_line(data)


def _parse_whole_text(data: bytes) -> FileMesh | None:
    """The mesh if its text is regular enough to be converted as a whole, else None."""
    words, parts = tokenize(data), tokenize(data, split_slashes=True)
    vertices = parse_vertices(words) if words else None
    polygons = parse_polygons(parts) if parts else None
    if vertices is None or polygons is None:
        return None
    return FileMesh(vertices, fan_triangulate(*polygons), polygons[1])


def _parse_line_by_line(data: bytes) -> FileMesh:
    vertices: list[tuple[float, ...]] = []
    polygons: list[list[int]] = []
    for number, line in _split_logical_lines(data):
        words = line.split(b"#", 1)[0].split()
        try:
            if words[:1] == [b"v"]:
                vertices.append(_parse_position(words[1:]))
            elif words[:1] == [b"f"]:
                polygons.append(_parse_polygon(words[1:], len(vertices)))
        except InputError as error:
            raise InputError(
                f"line {number}: `{_shorten_line(line)}` {error}; export it again"
            ) from error
    if not vertices or not polygons:
        raise InputError(
            f"{len(vertices)} vertices and {len(polygons)} faces found, expected a mesh in OBJ "
            "text; export it again"
        )
    last = max(map(max, polygons)) + 1
    if last > len(vertices):
        raise InputError(
            f"a face names vertex {last}, the file has {len(vertices)} (counted from 1); "
            "export it again"
        )
    return FileMesh(np.array(vertices), *fan_triangulate_polygons(polygons))


def _split_logical_lines(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Lines and their numbers from 1; one that ends in a backslash goes on in the next."""
    lines = iter(enumerate(data.splitlines(), start=1))
    for number, line in lines:
        while line.endswith(b"\\") and b"#" not in line:
            line = line[:-1] + b" " + next(lines, (0, b""))[1]
        yield number, line


def _parse_position(words: list[bytes]) -> tuple[float, ...]:
    if len(words) < 3:
        raise InputError(f"has {len(words)} coordinates, expected 3")
    try:
        x, y, z = (_parse_number(word) for word in words[:3])
    except ValueError as error:
        raise InputError("holds something else than numbers") from error
    return x, y, z


def _parse_number(word: bytes) -> float:
    if b"_" in word:
        raise ValueError("Python's digit separator is not a number in a file")
    return float(word)


def _parse_corner(word: bytes, count: int) -> int:
    """The vertex, from 0, that `v`, `v/vt`, `v/vt/vn` or `v//vn` names; negative counts back."""
    try:
        index = int(word.split(b"/", 1)[0])
    except ValueError as error:
        raise InputError("names a corner that is not a number") from error
    vertex = index - 1 if index > 0 else count + index
    if index == 0 or vertex < 0:
        raise InputError(f"names vertex {index}, but vertices are counted from 1")
    return vertex


def _parse_polygon(words: list[bytes], count: int) -> list[int]:
    if len(words) < 3:
        raise InputError(f"has {len(words)} corners, expected 3 or more")
    return [_parse_corner(word, count) for word in words]


def _shorten_line(line: bytes) -> str:
    text = line.decode("ascii", errors="replace").strip()
    return text if len(text) <= 60 else text[:57] + "..."
