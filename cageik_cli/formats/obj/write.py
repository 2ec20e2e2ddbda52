"""The text of an OBJ file, made ready for other positions of its vertices."""

import codecs
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.writer import Animation, FrameFileWriter
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers

_COMMENT_OR_CONTINUATION = re.compile(rb"#[^\r\n]*|\\(?:\r\n?|\n|\Z)")
"""What is as good as blanks: a comment, or the end of a line that goes on in the next."""

_CONTROLS_TO_MARKS = bytes.maketrans(bytes(set(range(32)) - set(b"\t\n\v\f\r")), b"?" * 27)
"""They divide no words, unlike the other bytes below the blank."""

_NUMBER_MARK = 0
"""Stands for a number, since no text has this byte."""

_BLOCK_BYTES = 1 << 22
"""Bytes that are gone through at once, and on to the end of a line."""


def make_obj_template(text: bytes) -> bytes:
    """A format of the text for the positions of its n vertices: it takes 3n numbers, no others.

    All else stays byte for byte, but for normals, which would be stale: `vn` lines are dropped,
    and the third index of corners.

    Parameters
    ----------
    text : bytes
        That `sequence.obj.parse_obj` reads.
    """
    body = text.removeprefix(codecs.BOM_UTF8)
    pieces, begin = [text[: len(text) - len(body)]], 0
    body = body.replace(b"%", b"%%")
    bare = _COMMENT_OR_CONTINUATION.sub(lambda found: b" " * len(found[0]), body).translate(
        _CONTROLS_TO_MARKS
    )
    while begin < len(body):
        end = bare.find(b"\n", begin + _BLOCK_BYTES) + 1 or len(body)
        pieces.append(_make_block_template(body[begin:end], bare[begin:end]))
        begin = end
    return b"".join(pieces)


@dataclass(frozen=True, slots=True, eq=False)
class _Tokens:
    """Where the words of a text stand.

    Attributes
    ----------
    codes : (b,) uint8
        The text.
    bounds : (w, 2) int64
        Where each word begins and ends.
    first_tokens : (l,) int64
        Number of the first word of each line that has any.
    line_bounds : (l, 2) int64
        Where these lines begin, and end behind their breaks.
    """

    codes: NDArray[np.uint8]
    bounds: Integers
    first_tokens: Integers
    line_bounds: Integers

    @classmethod
    def from_text(cls, text: bytes) -> "_Tokens":
        """The words of a text that has neither comments nor lines that go on in the next."""
        codes = np.frombuffer(text, np.uint8)
        is_break = codes == ord("\r")
        is_break[:-1] &= codes[1:] != ord("\n")
        is_break |= codes == ord("\n")
        breaks = np.flatnonzero(is_break) + 1
        is_blank = codes <= ord(" ")
        bounds = np.flatnonzero(np.diff(is_blank, prepend=True, append=True)).reshape(-1, 2)
        line = np.searchsorted(breaks, bounds[:, 0], side="right")
        heads = np.flatnonzero(np.diff(line, prepend=-1))
        ends = np.concatenate([[0], breaks, [len(codes)]])
        lines = line[heads, None] + np.arange(2)
        return cls(codes, bounds, heads, ends[lines])

    def find_lines(self, keyword: bytes) -> NDArray[np.bool_]:
        """Which lines begin with a word, (l,), and not with a longer one."""
        begins, ends = self.bounds[self.first_tokens].T
        found = np.asarray(ends - begins == len(keyword))
        for k, letter in enumerate(keyword):
            found[found] = self.codes[begins[found] + k] == letter
        return found


def _make_block_template(text: bytes, bare: bytes) -> bytes:
    """The format of some lines; `bare` is the text with blanks for what is as good as these."""
    words = _Tokens.from_text(bare)
    places = words.first_tokens[words.find_lines(b"v"), None] + np.arange(1, 4)
    numbers = words.bounds[places.ravel()]
    codes = np.frombuffer(text, np.uint8).copy()
    codes[numbers[:, 0]] = _NUMBER_MARK
    behind = numbers + np.array([1, 0])
    dropped = np.concatenate(
        [behind, words.line_bounds[words.find_lines(b"vn")], _find_normal_indices(words)]
    )
    # No two of these begin, or end, at one place.
    steps = np.zeros(len(codes) + 1, np.int8)
    steps[dropped[:, 0]] += 1
    steps[dropped[:, 1]] -= 1
    kept = np.cumsum(steps[:-1], dtype=np.int8) == 0
    left: bytes = codes[kept].tobytes()
    return left.replace(bytes([_NUMBER_MARK]), b"%.9g")


def _find_normal_indices(words: _Tokens) -> Integers:
    """Where the third index of each corner begins, with the slashes before it, and ends."""
    slashes = np.flatnonzero(words.codes == ord("/"))
    word = np.searchsorted(words.bounds[:, 0], slashes, side="right") - 1
    is_face = np.repeat(
        words.find_lines(b"f"), np.diff(words.first_tokens, append=len(words.bounds))
    )
    is_first = np.diff(word, prepend=-1) > 0
    second = np.flatnonzero(is_face[word] & ~is_first & np.roll(is_first, 1))
    # Without texture coordinates both slashes go.
    is_pair = slashes[second] == slashes[second - 1] + 1
    return np.stack([slashes[second] - is_pair, words.bounds[word[second], 1]], axis=1)


class Writer(FrameFileWriter):
    """Vertices with nine digits, which tell all float32 apart.

    All else is as in the OBJ file that the mesh was read from, if it was one, but for normals;
    without one they are triangles and nothing more.
    """

    suffixes = (".obj",)

    def __init__(self, target: Path, animation: Animation) -> None:
        super().__init__(target, animation)
        # One format of the whole file is several times as quick as one a line.
        text = animation.obj_text
        self._template = (
            make_obj_template(text) if text else _make_triangle_template(animation.rest)
        )

    def encode_frame(self, positions: Floats) -> bytes:
        """The text of one frame."""
        return self._template % tuple(positions.ravel().tolist())


def _make_triangle_template(mesh: TriMesh) -> bytes:
    """A format of vertices and faces alone."""
    faces = b"f %d %d %d\n" * len(mesh.faces) % tuple((mesh.faces + 1).ravel().tolist())
    return b"v %.9g %.9g %.9g\n" * len(mesh.vertices) + faces
