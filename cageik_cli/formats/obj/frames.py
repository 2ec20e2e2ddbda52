"""OBJ files as frames of a clip; only the vertices of most frames need parsing."""

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.file_data import with_gzip
from cageik_cli.formats.base.frame_files import FrameFileReader
from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.formats.obj.parse import parse_obj
from cageik_cli.formats.obj.tokens import FACE, VERTEX, Tokens, parse_vertices, tokenize
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
    def keep_obj_text(cls, data: bytes) -> bytes:
        """Return the text itself, for the writer keeps all but positions and normals."""
        return data


class ObjFrameParser:
    """Reads OBJ frames that from a face on are, byte for byte, a first frame.

    From which: the first face behind all vertices. What stands before it are vertices (with any
    spacing, colours or w, in lines that end in LF or CRLF), other faces, which are compared byte
    for byte too, and what is not compared: normals, texture coordinates, names, comments. Any
    other frame is left to `parse_obj`, as are those whose faces are spelt differently from frame
    to frame (because normals are numbered anew in each, say), have comments that touch numbers,
    or have all faces in front.

    Parameters
    ----------
    first : bytes
        The frame whose faces are known.
    vertices : (m, 3)
        What `parse_obj` reads in it.
    """

    def __init__(self, first: bytes, vertices: Floats) -> None:
        self._tail = b""
        words = tokenize(first)
        cut = _find_trailing_faces(words) if words else 0
        head = tokenize(first[:cut]) if cut else None
        found = parse_vertices(head) if head else None
        if head and found is not None and np.array_equal(found, vertices):
            self._tail = first[cut - 1 :]
            self._line_kinds, self._face_runs = _relevant_line_kinds(head), _find_face_runs(head)

    def parse_positions(self, data: bytes) -> Floats | None:
        """Vertices (m, 3) if the file is regular and its faces are the first frame's, else None."""
        if not self._tail or not data.endswith(self._tail):
            return None
        words = tokenize(data[: len(data) - len(self._tail) + 1])
        if words is None or not np.array_equal(_relevant_line_kinds(words), self._line_kinds):
            return None
        return parse_vertices(words) if _find_face_runs(words) == self._face_runs else None


def _find_trailing_faces(words: Tokens) -> int:
    """Where the line of the first face behind all vertices begins; 0 if there is none."""
    vertices = np.flatnonzero(words.line_kinds == VERTEX)
    faces = np.flatnonzero(words.line_kinds == FACE)
    behind = faces[faces > vertices.max(initial=-1)]
    if not len(behind):
        return 0
    return words.data.rfind(b"\n", 0, words.bounds[words.first_tokens[behind[0]], 0]) + 1


def _relevant_line_kinds(words: Tokens) -> NDArray[np.uint8]:
    """The kinds of lines that matter, in order: how many vertices each face has before it."""
    return np.asarray(words.line_kinds[words.line_kinds != 0])


def _find_face_runs(words: Tokens) -> list[bytes]:
    """The runs of lines that are faces, as they are spelt."""
    is_face = np.concatenate([[False], words.line_kinds == FACE, [False]])
    changes = np.flatnonzero(is_face[1:] != is_face[:-1])
    lines = np.append(words.bounds[words.first_tokens, 0], len(words.data))
    runs = lines[changes].reshape(-1, 2).tolist()
    return [words.data[begin:end] for begin, end in runs]
