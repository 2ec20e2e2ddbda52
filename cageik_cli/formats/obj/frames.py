"""OBJ files as frames of a clip; only the vertices of most frames need parsing."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.files import with_gzip
from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.formats.base.readers import FrameFileReader
from cageik_cli.formats.base.writers import Animation, FrameFileWriter, choose_short_names
from cageik_cli.formats.obj.surface import read_material_colours, read_obj_attributes
from cageik_cli.formats.obj.text import (
    FACE,
    VERTEX,
    Tokens,
    blank_out,
    parse_obj,
    parse_vertices,
    read_vertex_lines,
    tokenize,
)
from cageik_cli.geometry.attributes import NONE, FaceLabels, SurfaceAttributes
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.normals import compute_fan_normals
from cageik_cli.util.arrays import Floats, Integers

MIN_DIGITS = 9
"""Digits of coordinates, which distinguish all float32 values."""

EXACT = 0
"""In place of a number of digits: as many as each coordinate has."""


class Reader(FrameFileReader):
    """Frames from OBJ files."""

    suffixes = with_gzip(".obj")
    has_members = True
    has_parts = True

    @classmethod
    def parse(cls, data: bytes) -> FileMesh:
        """Parse the content of an OBJ file."""
        return parse_obj(data)

    @classmethod
    def make_frame_parser(
        cls, data: bytes, mesh: FileMesh
    ) -> Callable[[bytes], Floats | None] | None:
        """Return a parser of frames whose faces are spelt as in the first."""
        return ObjFrameParser(data, mesh.vertices).parse_positions

    @classmethod
    def read_attributes(cls, data: bytes, mesh: FileMesh) -> FileMesh:
        """Read UVs, normals, names of faces and colours of vertices."""
        return read_obj_attributes(data, mesh)

    @classmethod
    def read_library(cls, path: Path, mesh: FileMesh) -> FileMesh:
        """Read the colours of the materials."""
        return read_material_colours(path, mesh)


class ObjFrameParser:
    """Reads OBJ frames that end, byte for byte, as a first frame does.

    The end begins with the first face behind all vertices. What stands before it are vertices (in
    any spelling, with colours or w), other faces, which are compared byte for byte too, and what
    is not compared: normals, texture coordinates, names, comments. Any other frame is left to
    `parse_obj`: those whose faces are spelt differently from frame to frame (because normals are
    numbered anew in each, say), or have all faces in front.

    Parameters
    ----------
    first : bytes
        The frame whose faces are known.
    vertices : (m, 3)
        What `parse_obj` reads in it.
    """

    def __init__(self, first: bytes, vertices: Floats) -> None:
        self._tail, self._count = b"", len(vertices)
        cut = _find_trailing_faces(tokenize(blank_out(first)))
        if not cut:
            return
        head = tokenize(blank_out(first[:cut]))
        found = parse_vertices(head)
        if found is not None and np.array_equal(found, vertices, equal_nan=True):
            self._tail = first[cut - 1 :]
            self._line_kinds, self._face_runs = _relevant_line_kinds(head), _find_face_runs(head)

    def parse_positions(self, data: bytes) -> Floats | None:
        """Return the vertices (m, 3) if all faces are the first frame's, else None."""
        if not self._tail or not data.endswith(self._tail):
            return None
        length = len(data) - len(self._tail) + 1
        if not self._face_runs:
            vertices = read_vertex_lines(data, length, self._count)
            if vertices is not None:
                return vertices
        head = data[:length]
        # A last line that continues would take the first of the faces with it.
        if b"\0" in head or head.rstrip(b"\r\n").endswith(b"\\"):
            return None
        words = tokenize(blank_out(head))
        if not np.array_equal(_relevant_line_kinds(words), self._line_kinds):
            return None
        return parse_vertices(words) if _find_face_runs(words) == self._face_runs else None


def _find_trailing_faces(words: Tokens) -> int:
    """Return where the line of the first face behind all vertices begins; 0 if there is none."""
    vertices = np.flatnonzero(words.line_kinds == VERTEX)
    faces = np.flatnonzero(words.line_kinds == FACE)
    behind = faces[faces > vertices.max(initial=-1)]
    return int(words.line_bounds(behind[:1])[0, 0]) if len(behind) else 0


def _relevant_line_kinds(words: Tokens) -> NDArray[np.uint8]:
    """Return the kinds of vertex and face lines: how many vertices each face has before it."""
    return np.asarray(words.line_kinds[words.line_kinds != 0])


def _find_face_runs(words: Tokens) -> list[bytes]:
    """Return the runs of lines that are faces, as they are spelt."""
    is_face = np.concatenate([[False], words.line_kinds == FACE, [False]])
    changes = np.flatnonzero(is_face[1:] != is_face[:-1])
    lines = np.append(words.bounds[words.first_tokens, 0], len(words.text))
    runs = lines[changes].reshape(-1, 2).tolist()
    return [words.text[begin:end] for begin, end in runs]


class Writer(FrameFileWriter):
    """Writes vertices with nine digits, and with more where they are far from the origin.

    Polygons, UVs, names of faces and colours are those of the mesh. Normals are recomputed where
    it has some.
    """

    suffixes = (".obj",)
    keeps_parts = True

    def __init__(self, target: Path, animation: Animation) -> None:
        super().__init__(target, animation)
        self._rest, self._digits, self._template = animation.rest, -1, b""
        attributes = animation.rest.attributes
        has_normals = attributes is not None and attributes.normal_fans is not None
        self._shaded = attributes if has_normals else None

    def encode_frame(self, positions: Floats) -> bytes:
        """Return the text of one frame."""
        return self._encode(positions, count_digits(positions, self._rest.diagonal))

    def encode_exact(self, positions: Floats) -> bytes:
        """Return the text of one frame, whose positions are read back to the last bit."""
        return self._encode(positions, EXACT)

    def _encode(self, positions: Floats, digits: int) -> bytes:
        if digits != self._digits:
            # One format of the whole file is several times as fast as one per line.
            self._digits, self._template = digits, make_obj_template(self._rest, digits)
        numbers = positions.ravel().tolist()
        if self._shaded is not None:
            numbers += compute_fan_normals(self._shaded, positions).ravel().tolist()
        return self._template % tuple(numbers)


def count_digits(positions: Floats, diagonal: float) -> int:
    """Return the digits with which positions are rounded by at most 5e-8 of the diagonal."""
    largest = float(np.abs(positions).max())
    if not largest > diagonal > 0:
        return MIN_DIGITS
    return min(MIN_DIGITS + int(np.log10(largest / diagonal)), 17)  # all that float64 has


def make_obj_template(mesh: TriMesh, digits: int = MIN_DIGITS) -> bytes:
    """Return a format of the text of a mesh: it takes 3n positions, then 3u normals.

    `digits` are the significant digits of positions, or `EXACT`.
    """
    vertex = "v " + " ".join(["%r" if digits == EXACT else f"%.{digits}g"] * 3)
    attributes = mesh.attributes
    if attributes is None:
        faces = b"f %d %d %d\n" * len(mesh.faces) % tuple((mesh.faces + 1).ravel().tolist())
        return f"{vertex}\n".encode() * len(mesh.vertices) + faces
    library = _clean_name(attributes.material_library).replace("%", "%%")
    head = f"mtllib {library}\n" if library else ""
    if attributes.colours is None:
        head += f"{vertex}\n" * len(mesh.vertices)
    else:
        texts = (" ".join(map(repr, colour)) for colour in attributes.colours.tolist())
        head += "".join(f"{vertex} {text}\n" for text in texts)
    if attributes.uvs is not None:
        head += "".join(f"vt {u!r} {v!r}\n" for u, v in attributes.uvs.values.tolist())
    if attributes.normal_fans is not None:
        head += "vn %.6g %.6g %.6g\n" * (int(attributes.normal_fans.max()) + 1)
    lines = _write_polygons(attributes)
    return head.encode() + "".join(lines).replace("%", "%%").encode()


def encode_exact_obj(vertices: Floats, polygons: Iterable[Integers]) -> bytes:
    """Return the OBJ text of polygons whose vertices are read back to the last bit."""
    lines = b"v %r %r %r\n" * len(vertices) % tuple(vertices.ravel().tolist())
    faces = (" ".join(map(str, (ring + 1).tolist())) for ring in polygons)
    return lines + "".join(f"f {face}\n" for face in faces).encode()


def _write_polygons(attributes: SurfaceAttributes) -> Iterator[str]:
    """Yield the lines of the polygons, and before them those of names that change."""
    words = list(_write_corners(attributes))
    changes = _write_label_changes(attributes)
    starts = attributes.starts.tolist()
    for number, (start, count) in enumerate(
        zip(starts, attributes.corner_counts.tolist(), strict=True)
    ):
        yield from changes.get(number, ())
        yield f"f {' '.join(words[start : start + count])}\n"


def _write_corners(attributes: SurfaceAttributes) -> Iterator[str]:
    """Yield each corner as `v`, `v/vt`, `v//vn` or `v/vt/vn`, counted from 1."""
    absent = np.full(len(attributes.corners), NONE)
    uvs = absent if attributes.uvs is None else attributes.uvs.indices
    normals = absent if attributes.normal_fans is None else attributes.normal_fans
    columns = ((indices + 1).tolist() for indices in (attributes.corners, uvs, normals))
    for vertex, uv, normal in zip(*columns, strict=True):
        if normal:
            yield f"{vertex}/{uv or ''}/{normal}"
        else:
            yield f"{vertex}/{uv}" if uv else str(vertex)


def _write_label_changes(attributes: SurfaceAttributes) -> dict[int, list[str]]:
    """Return the lines of names before the polygons at which they change, by its number."""
    found: dict[int, list[str]] = {}
    objects, parts = attributes.objects, attributes.parts
    if parts is not None:
        indices = np.repeat(np.arange(len(parts.names)), parts.polygon_counts)
        objects = FaceLabels(tuple(choose_short_names(parts.names)), indices)
    for labels, keyword, none in (
        (objects, "o", "default"),
        (attributes.groups, "g", "default"),
        (attributes.materials, "usemtl", "default"),
        (attributes.smoothing, "s", "off"),
    ):
        if labels is None:
            continue
        for number in np.flatnonzero(np.diff(labels.indices, prepend=NONE)).tolist():
            index = int(labels.indices[number])
            name = "" if index == NONE else _clean_name(labels.names[index])
            found.setdefault(number, []).append(f"{keyword} {name or none}\n")
    return found


def _clean_name(name: str) -> str:
    """Return a name without what OBJ takes for a comment, or for a line that continues."""
    name = name.replace("#", "_")
    return name[:-1] + "_" if name.endswith("\\") else name
