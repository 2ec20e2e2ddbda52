"""OBJ frames of which only the vertices need parsing, for their faces are those of a first."""

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.obj.tokens import FACE, VERTEX, Words, vertices_of, words_of
from cageik_cli.util.arrays import Floats


class FrameParser:
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
        words = words_of(first)
        cut = _last_faces(words) if words else 0
        head = words_of(first[:cut]) if cut else None
        found = vertices_of(head) if head else None
        if head and found is not None and np.array_equal(found, vertices):
            self._tail = first[cut - 1 :]
            self._lines, self._faces = _compared(head), _faces(head)

    def positions(self, data: bytes) -> Floats | None:
        """Vertices (m, 3) if the file is regular and its faces are the first frame's, else None."""
        if not self._tail or not data.endswith(self._tail):
            return None
        words = words_of(data[: len(data) - len(self._tail) + 1])
        if words is None or not np.array_equal(_compared(words), self._lines):
            return None
        return vertices_of(words) if _faces(words) == self._faces else None


def _last_faces(words: Words) -> int:
    """Where the line of the first face behind all vertices begins; 0 if there is none."""
    vertices = np.flatnonzero(words.kinds == VERTEX)
    faces = np.flatnonzero(words.kinds == FACE)
    behind = faces[faces > vertices.max(initial=-1)]
    if not len(behind):
        return 0
    return words.data.rfind(b"\n", 0, words.bounds[words.heads[behind[0]], 0]) + 1


def _compared(words: Words) -> NDArray[np.uint8]:
    """The kinds of lines that matter, in order: how many vertices each face has before it."""
    return np.asarray(words.kinds[words.kinds != 0])


def _faces(words: Words) -> list[bytes]:
    """The runs of lines that are faces, as they are spelt."""
    is_face = np.concatenate([[False], words.kinds == FACE, [False]])
    changes = np.flatnonzero(is_face[1:] != is_face[:-1])
    lines = np.append(words.bounds[words.heads, 0], len(words.data))
    runs = lines[changes].reshape(-1, 2).tolist()
    return [words.data[begin:end] for begin, end in runs]
