"""OBJ files as frames of a clip; only the vertices of most frames need parsing."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.file_data import with_gzip
from cageik_cli.formats.base.frame_files import FrameFileReader
from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.formats.obj.attributes import read_obj_attributes
from cageik_cli.formats.obj.materials import read_material_colours
from cageik_cli.formats.obj.numbers import read_vertex_lines
from cageik_cli.formats.obj.parse import parse_obj
from cageik_cli.formats.obj.tokens import (
    FACE,
    VERTEX,
    Tokens,
    blank_out,
    parse_vertices,
    tokenize,
)
from cageik_cli.util.arrays import Floats


class Reader(FrameFileReader):
    """Frames from OBJ files."""

    suffixes = with_gzip(".obj")

    @classmethod
    def parse(cls, data: bytes) -> FileMesh:
        """Parse the content of an OBJ file."""
        return parse_obj(data)

    @classmethod
    def make_frame_parser(cls, data: bytes, mesh: FileMesh) -> "ObjFrameParser":
        """Return a parser of frames whose faces are spelt as in the first."""
        return ObjFrameParser(data, mesh.vertices)

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
