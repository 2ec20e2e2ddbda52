"""STL, binary and ASCII: triangles without shared vertices; read only.

Their equal corners are welded into vertices, once.
"""

import codecs
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from io import BytesIO
from typing import NoReturn

import numpy as np

from cageik_cli.formats.base.files import with_gzip
from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.formats.base.readers import FrameFileReader
from cageik_cli.geometry.attributes import MAX_NAME_LENGTH, Parts, SurfaceAttributes
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import ConnectivityError, FormatError
from cageik_cli.util.messages import say
from cageik_cli.util.text import format_count, group_digits, number_names, single_line, to_unicode

HEADER_BYTES = 84
"""Bytes before the triangles of a binary file: 80 of anything, and the number of triangles."""

TRIANGLE_BYTES = 50
"""Bytes of a triangle: its normal and three corners in single precision, and two of anything."""

Solids = list[tuple[str, int]]
"""The name of each solid that has triangles, and how many."""

# Possessive, so that what does not match is refused in one pass, however long a number is.
_COORDINATE = (
    rb"[ \t]++[-+]?(?:(?:\d++(?:\.\d*+)?|\.\d++)(?:e[-+]?\d++)?|nan(?:\(\w*+\))?|inf(?:inity)?)"
)

_END_OF_LINE = rb"[^\S\n]*+\n\s*+"

_FACET = re.compile(
    rb"\s*+facet[ \t]++normal"
    + 3 * _COORDINATE
    + _END_OF_LINE
    + rb"outer[ \t]++loop"
    + _END_OF_LINE
    + 3 * (rb"vertex" + 3 * _COORDINATE + _END_OF_LINE)
    + rb"endloop\s++endfacet(?!\S)",
    re.IGNORECASE,
)

_SOLID = re.compile(rb"\s*+solid(?!\S)([^\n]*+)", re.IGNORECASE)

_END = re.compile(rb"\s*+endsolid(?!\S)[^\n]*+", re.IGNORECASE)

ROUNDING = float(np.finfo(np.float32).eps)
"""Corners of one vertex differ by this share of the largest coordinate at most: by their rounding
to single precision."""


class Reader(FrameFileReader):
    """Frames from STL files. The vertices of all are those of the first, or of the rest pose."""

    suffixes = with_gzip(".stl")
    has_members = True
    has_parts = True
    numbers_vertices = False

    @classmethod
    def parse(cls, data: bytes) -> FileMesh:
        """Parse the content of an STL file, and weld corners of a solid at equal positions."""
        corners, solids = _read_corners(data)
        names, counts = zip(*solids, strict=True)
        owners = np.repeat(np.arange(len(counts)), counts)
        vertices, numbers = weld_corners(corners, np.repeat(owners, 3))
        corner_counts = np.full(len(owners), 3)
        attributes = None
        if len(solids) > 1:
            vertex_owners = np.empty(len(vertices), np.int64)
            vertex_owners[numbers] = np.repeat(owners, 3)
            parts = Parts(
                names=tuple(number_names(names)),
                vertex_counts=np.bincount(vertex_owners),
                polygon_counts=np.array(counts),
                transforms=np.tile(np.eye(4), (len(solids), 1, 1)),
            )
            attributes = SurfaceAttributes(corner_counts, numbers, parts=parts)
        found = format_count(len(vertices), "vertex")
        note = f"{len(corners)} corners welded into {found} where they are equal"
        return FileMesh(vertices, numbers, corner_counts, attributes, left_out=(note,))

    @classmethod
    def number_vertices(cls, mesh: FileMesh, rest: TriMesh) -> FileMesh:
        """Number vertices as the rest pose does, if it has the same triangles."""
        return number_as_rest(mesh, rest)

    @classmethod
    def make_frame_parser(
        cls, data: bytes, mesh: FileMesh
    ) -> Callable[[bytes], Floats | None] | None:
        """Return a parser that takes the vertices of the first frame from the same corners."""
        corner_map = CornerMap(mesh.corners, len(mesh.vertices))

        def parse_positions(content: bytes) -> Floats | None:
            if not content:
                return None
            return corner_map.find_positions(_read_corners(content)[0])

        return parse_positions


def _read_corners(data: bytes) -> tuple[Floats, Solids]:
    """Read the corners (c, 3) of all triangles of a file, and its solids."""
    count, size = 0, len(data)
    if size >= HEADER_BYTES:
        (count,) = struct.unpack_from("<I", data, HEADER_BYTES - 4)
    expected = HEADER_BYTES + TRIANGLE_BYTES * count
    solids: Solids = [("", count)]
    if size != expected:
        data = data.removeprefix(codecs.BOM_UTF8)
        if b"\0" in data or data.lstrip()[:5].lower() != b"solid":
            if size < HEADER_BYTES:
                raise FormatError(
                    f"{size} bytes that do not begin with `solid`, expected STL: text, or at least "
                    f"{HEADER_BYTES} bytes; export it again"
                )
            raise FormatError(
                f"announces {group_digits(count)} triangles, which take {expected} bytes, but "
                f"has {size}, and is "
                "no text that begins with `solid`: it is cut short, damaged or not STL; export it "
                "again"
            )
        data, solids = _check_text(data)
        count = sum(number for _, number in solids)
    if not count:
        raise FormatError("holds no triangle, expected a mesh; export it again")
    return _load_corners(data, count), solids


def _load_corners(data: bytes, count: int) -> Floats:
    """Let trimesh read the corners (3 count, 3) of an STL file of one solid, in its order.

    Its loader alone, not `trimesh.load`, which would build a mesh of its own: there is nothing
    to merge, to sort or to look up elsewhere.
    """
    from trimesh.exchange.stl import load_stl

    try:
        loaded = load_stl(BytesIO(data))["vertices"]
        with np.errstate(invalid="ignore"):  # numbers that signal that they are none
            corners = np.array(loaded, np.float64)
    except Exception as error:  # whatever trimesh meets
        raise FormatError(f"is not a sound STL mesh ({error}); export it again") from error
    if corners.shape != (3 * count, 3):
        raise FormatError(
            f"holds {group_digits(count)} triangles, but {group_digits(corners.size // 9)} can "
            "be read; export it again"
        )
    return corners


def _check_text(data: bytes) -> tuple[bytes, Solids]:
    """Return an ASCII file as one solid without a name, and the solids that it has.

    trimesh takes what stands behind each `vertex`, in names too, and leaves out a solid without
    end; so all that it is given is looked at before.
    """
    text = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").rstrip()
    solids: Solids = []
    place, facets = 0, []
    while place < len(text):
        head = _SOLID.match(text, place)
        if head is None:
            _refuse_line(text, place, "`solid NAME`")
        start = place = head.end()
        count = 0
        while facet := _FACET.match(text, place):
            place, count = facet.end(), count + 1
        end = _END.match(text, place)
        if end is None:
            _refuse_line(
                text,
                place,
                "a whole facet (`facet normal X Y Z`, `outer loop`, three lines `vertex X Y Z`, "
                "`endloop`, `endfacet`) or `endsolid`",
            )
        if count:
            name = single_line(to_unicode(head[1].strip().decode(errors="replace")))
            solids.append((name[: MAX_NAME_LENGTH // 2] or "solid", count))
            facets.append(text[start:place])
        place = end.end()
    return b"solid\n%b\nendsolid\n" % b"\n".join(facets), solids


def _refuse_line(text: bytes, place: int, expected: str) -> NoReturn:
    """Refuse what begins at a place, behind blanks; the file is not quoted."""
    rest = text[place:].lstrip()
    line = 1 + text.count(b"\n", 0, len(text) - len(rest))
    if not rest:
        raise FormatError(
            f"ends in line {line}, expected {expected}; it is cut short, export it again"
        )
    raise FormatError(f"line {line} does not begin {expected}; export it again")


def weld_corners(corners: Floats, solids: Integers) -> tuple[Floats, Integers]:
    """Return the different positions among corners, and the number of each corner's.

    They are numbered as they come. A corner that is not a number is equal to none.

    Parameters
    ----------
    corners : (c, 3)
    solids : (c,)
        The solid of each corner, ascending; corners of two solids are never welded.

    Returns
    -------
    vertices : (n, 3)
    numbers : (c,)
    """
    order = np.lexsort((*corners.T, solids))  # stable: equal corners stay in their order
    ordered, owners = corners[order], solids[order]
    differs = (ordered[1:] != ordered[:-1]).any(axis=1) | (owners[1:] != owners[:-1])
    is_new = np.concatenate([[True], differs])
    firsts = order[is_new]
    by_place = np.argsort(firsts)
    ranks = np.empty(len(firsts), np.int64)
    ranks[by_place] = np.arange(len(firsts))
    numbers = np.empty(len(corners), np.int64)
    numbers[order] = ranks[np.cumsum(is_new) - 1]
    return corners[firsts[by_place]], numbers


@dataclass(frozen=True, eq=False)
class CornerMap:
    """Which vertex each corner of a mesh is, for files of the same triangles in the same order.

    Attributes
    ----------
    numbers : (c,) int64
        Numbers of vertices, three for each triangle.
    vertex_count : int
    """

    numbers: Integers
    vertex_count: int

    @cached_property
    def _first_corners(self) -> Integers:
        """A corner of each vertex that has one, (n,)."""
        return np.asarray(np.unique(self.numbers, return_index=True)[1])

    def find_positions(self, corners: Floats) -> Floats:
        """Return the position of each vertex, (n, 3), of the positions of corners (c, 3).

        Raises
        ------
        ConnectivityError
            When there are more or fewer triangles, corners of a vertex are at several places, or
            some vertices are in no triangle.
        """
        if len(corners) != len(self.numbers):
            found, wanted = len(corners) // 3, len(self.numbers) // 3
            cut = "; if it is cut off, export it again" * (found < wanted)
            raise ConnectivityError(
                f"{group_digits(found)} triangles, the rest pose has {group_digits(wanted)}; all "
                "must share one "
                f"connectivity{cut}"
            )
        if len(self._first_corners) != self.vertex_count:
            lone = format_count(self.vertex_count - len(self._first_corners), "vertex")
            raise ConnectivityError(f"lacks {lone} of the rest pose, which no triangle has")
        vertices = corners[self._first_corners]
        own = vertices[self.numbers]
        largest = np.abs(corners[np.isfinite(corners)]).max(initial=0)
        is_near = np.isclose(corners, own, rtol=0, atol=ROUNDING * largest, equal_nan=True)
        apart = np.flatnonzero(~is_near.all(axis=1))
        if len(apart):
            self._refuse_split_corners(corners, int(apart[0]), len(apart))
        return vertices

    def _refuse_split_corners(self, corners: Floats, corner: int, count: int) -> None:
        vertex = int(self.numbers[corner])
        first = int(self._first_corners[vertex])
        here, there = ("({:g}, {:g}, {:g})".format(*corners[k]) for k in (first, corner))
        raise ConnectivityError(
            f"triangles {first // 3} and {corner // 3} (counted from 0) share vertex "
            f"{vertex} of the rest pose, but have it at {here} and {there} "
            f"({format_count(count, 'corner')} differ so); all frames must have the "
            "triangles in one order, and the format has no vertices, only corners: "
            + say(
                "export the frames as .obj or .ply, or give the mesh whose triangles they "
                "are by `rest=`, as .obj or .ply"
            )
        )


def number_as_rest(mesh: FileMesh, rest: TriMesh) -> FileMesh:
    """Return a mesh of welded corners with the vertices of the rest pose; itself if it has others.

    The rest pose keeps apart what is at one place, such as closed lips.
    """
    faces = rest.fan_triangulated.faces
    corner_map = CornerMap(faces.ravel(), len(rest.vertices))
    try:
        vertices = corner_map.find_positions(mesh.vertices[mesh.corners])
    except ConnectivityError:
        return mesh  # the rest pose is compared with the clip after that
    return replace(
        mesh,
        vertices=vertices,
        corners=corner_map.numbers,
        attributes=None,
        left_out=("vertices numbered as in the rest pose",),
    )


def number_as_clip(rest: TriMesh, first: TriMesh) -> TriMesh:
    """Return a rest pose of welded corners with the vertices of a clip; itself if it has others."""
    faces = first.fan_triangulated.faces
    if np.array_equal(rest.faces, faces):
        return rest
    corner_map = CornerMap(faces.ravel(), len(first.vertices))
    try:
        return TriMesh(corner_map.find_positions(rest.vertices[rest.faces.ravel()]), faces)
    except ConnectivityError:
        return rest  # it is compared with the clip after that
