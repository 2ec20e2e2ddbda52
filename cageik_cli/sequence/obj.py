"""Wavefront OBJ: positions and faces, in the file's order; nothing merged, split or reordered."""

import codecs
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow
import pyarrow.csv
from numpy.typing import NDArray

from cageik_cli.errors import InputError
from cageik_cli.mesh import Floats, Integers, TriMesh
from cageik_cli.sequence.polygons import fans

_PREAMBLE = (b"#", b"o", b"g", b"s", b"mtllib", b"usemtl")


@dataclass(frozen=True, slots=True, eq=False)
class FileMesh:
    """What a mesh file holds, not yet checked.

    Attributes
    ----------
    vertices : (n, 3) float64
        Each value is `float(text)` to the bit; may not be finite.
    faces : (f, 3) int64
        From 0; polygons are cut into fans at their first corner.
    sizes : (p,) int64
        How many corners each face of the file has.
    """

    vertices: Floats
    faces: Integers
    sizes: Integers

    @property
    def polygons(self) -> int:
        """How many faces have more than three corners."""
        return int(np.count_nonzero(self.sizes > 3))

    @property
    def fanned(self) -> TriMesh:
        """The mesh, checked, with its polygons as fans: what connectivity is compared by."""
        return TriMesh(self.vertices, self.faces)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was changed, one sentence each."""
        plural = "s" * (self.polygons > 1)
        return (f"{self.polygons} polygon{plural} cut into triangles",) if self.polygons else ()


class FrameParser:
    """Reads OBJ frames whose face block is, byte for byte, that of a first frame.

    Only the vertices of such a file need parsing, by a CSV engine; anything else is left to
    `parse_obj`.

    Parameters
    ----------
    first : bytes
        The frame whose faces are known.
    """

    def __init__(self, first: bytes) -> None:
        _, self._tail = _split(first)
        if _has_vertices(self._tail):
            self._tail = b""

    def positions(self, data: bytes) -> Floats | None:
        """Vertices (m, 3) if the file is plain and its faces are the first frame's, else None."""
        head, tail = _split(data)
        return plain_vertices(head) if tail and tail == self._tail else None


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
    return _plain_mesh(data) or _mesh_by_lines(data)


def plain_vertices(head: bytes) -> Floats | None:
    """Vertices of a block of nothing but `v x y z` lines after comments and names, else None."""
    start = 0 if head.startswith(b"v ") else head.find(b"\nv ") + 1
    if not _is_preamble(head[:start]):
        return None
    return _columns(head[start:], b"v ", np.float64)


def _plain_mesh(data: bytes) -> FileMesh | None:
    """The mesh if it is but a block of vertices and a block of triangles, else None."""
    head, tail = _split(data)
    vertices = plain_vertices(head)
    faces = _columns(tail, b"f ", np.int64)
    if vertices is None or faces is None or faces.min() < 1 or faces.max() > len(vertices):
        return None
    return FileMesh(vertices, faces - 1, np.full(len(faces), 3))


def _mesh_by_lines(data: bytes) -> FileMesh:
    vertices: list[tuple[float, ...]] = []
    polygons: list[list[int]] = []
    for number, line in _logical_lines(data):
        words = line.split(b"#", 1)[0].split()
        try:
            if words[:1] == [b"v"]:
                vertices.append(_position(words[1:]))
            elif words[:1] == [b"f"]:
                polygons.append(_polygon(words[1:], len(vertices)))
        except InputError as error:
            raise InputError(f"line {number}: `{_shown(line)}` {error}; export it again") from error
    if not vertices or not polygons:
        raise InputError(
            f"{len(vertices)} vertices and {len(polygons)} faces found, expected a mesh in OBJ text"
        )
    last = max(map(max, polygons)) + 1
    if last > len(vertices):
        raise InputError(
            f"a face names vertex {last}, the file has {len(vertices)} (counted from 1); "
            "export it again"
        )
    return FileMesh(np.array(vertices), *fans(polygons))


def _columns(block: bytes, start: bytes, kind: type[np.generic]) -> NDArray[Any] | None:
    """The three numbers of lines that all begin with `start`, (count, 3); None of other lines."""
    if not block.startswith(start):
        return None
    names = ["start", "a", "b", "c"]
    numbers = names[1:]
    try:
        table = pyarrow.csv.read_csv(
            pyarrow.py_buffer(block),
            read_options=pyarrow.csv.ReadOptions(
                use_threads=False, block_size=len(block) + 1, column_names=names
            ),
            parse_options=pyarrow.csv.ParseOptions(delimiter=" ", quote_char=False),
            convert_options=pyarrow.csv.ConvertOptions(
                include_columns=numbers,
                column_types=dict.fromkeys(numbers, pyarrow.from_numpy_dtype(kind)),
                null_values=[],
            ),
        )
    except pyarrow.ArrowInvalid:
        return None
    count = len(table)
    if block.count(b"\n" + start) + 1 != count:
        return None
    # Out of the buffers, for pyarrow's own conversion imports pandas where it is installed.
    columns = [column.chunk(0).buffers()[1] for column in table.columns]
    return np.stack([np.frombuffer(column, kind, count) for column in columns], axis=1)


def _split(data: bytes) -> tuple[bytes, bytes]:
    """What stands before the first face, and from it on."""
    cut = data.find(b"\nf ") + 1
    return (data[:cut], data[cut:]) if cut else (data, b"")


def _logical_lines(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Lines and their numbers from 1; one that ends in a backslash goes on in the next."""
    lines = iter(enumerate(data.splitlines(), start=1))
    for number, line in lines:
        while line.endswith(b"\\") and b"#" not in line:
            line = line[:-1] + b" " + next(lines, (0, b""))[1]
        yield number, line


def _has_vertices(tail: bytes) -> bool:
    return any(line.split(maxsplit=1)[:1] == [b"v"] for line in tail.splitlines())


def _is_preamble(text: bytes) -> bool:
    if b"\\" in text or b"\0" in text:
        return False
    words = (line.split(maxsplit=1)[0] for line in text.splitlines() if line.strip())
    return all(word in _PREAMBLE or word.startswith(b"#") for word in words)


def _position(words: list[bytes]) -> tuple[float, ...]:
    if len(words) < 3:
        raise InputError(f"has {len(words)} coordinates, expected 3")
    try:
        x, y, z = (_number(word) for word in words[:3])
    except ValueError as error:
        raise InputError("holds something else than numbers") from error
    return x, y, z


def _number(word: bytes) -> float:
    if b"_" in word:
        raise ValueError("Python's digit separator is not a number in a file")
    return float(word)


def _corner(word: bytes, count: int) -> int:
    """The vertex, from 0, that `v`, `v/vt`, `v/vt/vn` or `v//vn` names; negative counts back."""
    try:
        index = int(word.split(b"/", 1)[0])
    except ValueError as error:
        raise InputError("names a corner that is not a number") from error
    vertex = index - 1 if index > 0 else count + index
    if index == 0 or vertex < 0:
        raise InputError(f"names vertex {index}, but vertices are counted from 1")
    return vertex


def _polygon(words: list[bytes], count: int) -> list[int]:
    if len(words) < 3:
        raise InputError(f"has {len(words)} corners, expected 3 or more")
    return [_corner(word, count) for word in words]


def _shown(line: bytes) -> str:
    text = line.decode("ascii", errors="replace").strip()
    return text if len(text) <= 60 else text[:57] + "..."
