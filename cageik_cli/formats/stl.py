"""STL, binary and ASCII: triangles without shared vertices, which are welded; read only."""

import codecs
import re
import struct
from collections.abc import Callable
from io import BytesIO
from typing import NoReturn

import numpy as np

from cageik_cli.formats.base.files import with_gzip
from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.formats.base.readers import FrameFileReader
from cageik_cli.formats.base.welding import CornerMap, number_as_rest, weld_corners
from cageik_cli.geometry.attributes import MAX_NAME_LENGTH, Parts, SurfaceAttributes
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FormatError
from cageik_cli.util.text import format_count, number_names, single_line, to_unicode

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
            _refuse_binary(size, count)
        data, solids = _check_text(data)
        count = sum(number for _, number in solids)
    if not count:
        raise FormatError("holds no triangle, expected a mesh; export it again")
    return _load_corners(data, count), solids


def _refuse_binary(size: int, count: int) -> NoReturn:
    """Refuse a file that is no text, and whose header announces another size."""
    if size < HEADER_BYTES:
        raise FormatError(
            f"{size} bytes that do not begin with `solid`, expected STL: text, or at least "
            f"{HEADER_BYTES} bytes; export it again"
        )
    raise FormatError(
        f"announces {count} triangles, which take {HEADER_BYTES + TRIANGLE_BYTES * count} bytes, "
        f"but has {size}, and is no text that begins with `solid`: it is cut short, damaged or not "
        "STL; export it again"
    )


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
            f"holds {count} triangles, but {corners.size // 9} can be read; export it again"
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
