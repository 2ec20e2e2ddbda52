"""OBJ files with other positions; all other text of the original file is kept."""

import codecs
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from cageik_cli.formats.base.writer import Animation, FrameFileWriter
from cageik_cli.formats.obj.tokens import FACE, VERTEX, Tokens, blank_out, tokenize
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers

_NUMBER_MARK = 0
"""Marks the place of a number, since no text has this byte."""

_BLOCK_BYTES = 1 << 22
"""Bytes whose words are found at once, and on to the end of a line."""


MIN_DIGITS = 9
"""Digits of coordinates, which distinguish all float32 values."""

MAX_DIGITS = 17
"""More than enough for all float64 values."""


def make_obj_template(text: bytes, digits: int = MIN_DIGITS) -> bytes:
    """Return a format of the text for the positions of its n vertices: it takes 3n numbers.

    All else stays byte for byte, but for normals, which would be stale: `vn` lines are dropped,
    and the third index of corners.

    Parameters
    ----------
    text : bytes
        That `parse_obj` reads.
    digits : int
        Significant digits of the numbers.
    """
    number = _make_number_format(digits)
    body = text.removeprefix(codecs.BOM_UTF8)
    pieces, begin = [text[: len(text) - len(body)]], 0
    body = body.replace(b"%", b"%%")
    bare = blank_out(body)
    while begin < len(body):
        end = bare.find(b"\n", begin + _BLOCK_BYTES) + 1 or len(body)
        block = _make_block_template(body[begin:end], tokenize(bare[begin:end]))
        pieces.append(block.replace(bytes([_NUMBER_MARK]), number))
        begin = end
    return b"".join(pieces)


def _make_block_template(text: bytes, words: Tokens) -> bytes:
    """Return the format of some lines, whose words are known, with marks in place of numbers."""
    places = words.first_tokens[words.line_kinds == VERTEX, None] + np.arange(1, 4)
    numbers = words.bounds[places.ravel()]
    codes = np.frombuffer(text, np.uint8).copy()
    codes[numbers[:, 0]] = _NUMBER_MARK
    behind = numbers + np.array([1, 0])
    normals = words.line_bounds(np.flatnonzero(words.find_lines(b"vn")))
    dropped = np.concatenate([behind, normals, _find_normal_indices(words)])
    # No two of these begin, or end, at one place; the last may end at a newline that was added.
    steps = np.zeros(len(codes) + 2, np.int8)
    steps[dropped[:, 0]] += 1
    steps[dropped[:, 1]] -= 1
    kept = np.cumsum(steps[: len(codes)], dtype=np.int8) == 0
    left: bytes = codes[kept].tobytes()
    return left


def _find_normal_indices(words: Tokens) -> Integers:
    """Return where the third index of each corner begins, with the slashes before it, and ends."""
    slashes = np.flatnonzero(words.codes == ord("/"))
    word = np.searchsorted(words.bounds[:, 0], slashes, side="right") - 1
    is_face = np.repeat(words.line_kinds == FACE, words.token_counts)
    is_first = np.diff(word, prepend=-1) > 0
    second = np.flatnonzero(is_face[word] & ~is_first & np.roll(is_first, 1))
    # Without texture coordinates both slashes go.
    is_pair = slashes[second] == slashes[second - 1] + 1
    return np.stack([slashes[second] - is_pair, words.bounds[word[second], 1]], axis=1)


class Writer(FrameFileWriter):
    """Writes vertices with nine digits, and with more where they are far from the origin.

    Everything else but normals is as in the OBJ file that the mesh was read from; a mesh of another
    format is written as vertices and triangles alone.
    """

    suffixes = (".obj",)

    def __init__(self, target: Path, animation: Animation) -> None:
        super().__init__(target, animation)
        self._animation, self._digits, self._template = animation, 0, b""

    def encode_frame(self, positions: Floats) -> bytes:
        """Return the text of one frame."""
        digits = count_digits(positions, self._animation.rest.diagonal)
        if digits != self._digits:
            # One format of the whole file is several times as fast as one per line.
            text, rest = self._animation.obj_text, self._animation.rest
            self._digits = digits
            self._template = (
                make_obj_template(text, digits) if text else _make_triangle_template(rest, digits)
            )
        return self._template % tuple(positions.ravel().tolist())


def count_digits(positions: Floats, diagonal: float) -> int:
    """Return the digits with which positions are rounded by at most 5e-8 of the diagonal."""
    largest = float(np.abs(positions).max())
    if not largest > diagonal > 0:
        return MIN_DIGITS
    return min(MIN_DIGITS + int(np.log10(largest / diagonal)), MAX_DIGITS)


def _make_number_format(digits: int) -> bytes:
    return f"%.{digits}g".encode()


def _make_triangle_template(mesh: TriMesh, digits: int) -> bytes:
    """Return a format of vertices and triangles alone."""
    number = _make_number_format(digits)
    vertex = b"v " + b" ".join([number] * 3) + b"\n"
    faces = b"f %d %d %d\n" * len(mesh.faces) % tuple((mesh.faces + 1).ravel().tolist())
    return vertex * len(mesh.vertices) + faces


def encode_exact_obj(vertices: Floats, polygons: Iterable[Integers]) -> bytes:
    """Return the OBJ text of polygons whose vertices are read back to the last bit."""
    lines = b"v %r %r %r\n" * len(vertices) % tuple(vertices.ravel().tolist())
    faces = (" ".join(map(str, (ring + 1).tolist())) for ring in polygons)
    return lines + "".join(f"f {face}\n" for face in faces).encode()
