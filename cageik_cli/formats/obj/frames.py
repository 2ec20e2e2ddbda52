"""OBJ files as frames of a clip; only the vertices of most frames need parsing.

Besides, a file has UVs, normals, names of faces and colours of vertices; its library of materials
has their colours.
"""

import codecs
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.files import with_gzip
from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.formats.base.readers import FrameFileReader
from cageik_cli.formats.base.writers import Animation, FrameFileWriter, choose_short_names
from cageik_cli.formats.obj.text import (
    FACE,
    VERTEX,
    Tokens,
    blank_out,
    convert_words,
    leave_out_short_faces,
    parse_obj,
    parse_vertices,
    read_vertex_lines,
    tokenize,
)
from cageik_cli.geometry.attributes import (
    LABEL_NAMES,
    NONE,
    PLAIN_COLOUR,
    FaceLabels,
    Parts,
    SurfaceAttributes,
    number_normal_fans,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import compute_fan_normals
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FileAccessError, FormatError
from cageik_cli.util.files import read_input
from cageik_cli.util.text import format_count, single_line

KEYWORDS = {
    "uvs": b"vt",
    "normal_fans": b"vn",
    "objects": b"o",
    "groups": b"g",
    "materials": b"usemtl",
    "smoothing": b"s",
}
"""The lines that hold a layer of the surface; names of faces are written in this order."""

MIN_DIGITS = 9
"""Digits of coordinates, which distinguish all float32 values."""

EXACT = 0
"""In place of a number of digits: as many as each coordinate has."""

COLOURED_WORDS = 7
"""Words of a line of a vertex with a colour; a fourth number alone is a weight."""

MAX_LIBRARY_BYTES = 1 << 24
"""Bytes of all libraries of materials that are read: a hundred thousand materials."""


class Reader(FrameFileReader):
    """Frames from OBJ files."""

    suffixes = with_gzip(".obj")
    has_members = True
    has_parts = True

    @classmethod
    def parse(cls, data: bytes) -> FileMesh:
        """Parse the content of an OBJ file, without faces that have fewer than three corners."""
        try:
            return parse_obj(data)
        except FormatError:
            whole, count = leave_out_short_faces(data)
            if not count:
                raise
            note = f"{format_count(count, 'face')} of fewer than 3 corners left out"
            return replace(parse_obj(whole), left_out=(note,))

    @classmethod
    def make_frame_parser(
        cls, data: bytes, mesh: FileMesh
    ) -> Callable[[bytes], Floats | None] | None:
        """Return a parser of frames whose faces are spelt as in the first."""
        return ObjFrameParser(data, mesh.vertices).parse_positions

    @classmethod
    def read_attributes(cls, data: bytes, mesh: FileMesh) -> FileMesh:
        """Read UVs, normals, names of faces and colours of vertices."""
        return read_obj_attributes(leave_out_short_faces(data)[0] if mesh.left_out else data, mesh)

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


def read_obj_attributes(data: bytes, mesh: FileMesh) -> FileMesh:
    """Return a mesh that was parsed with all else that its OBJ text says of the surface.

    What is damaged, such as indices of UVs that are not there, is left out with a note.
    """
    if _is_bare(data):
        return mesh
    tokens = tokenize(blank_out(data.removeprefix(codecs.BOM_UTF8)))
    return mesh.read_layers(
        {
            "its texture coordinates are": partial(_read_uvs, tokens),
            "its normals are": partial(_read_normals, tokens),
            "its names of faces are": partial(_read_labels, tokens),
            "its colours are": partial(_read_colours, tokens),
            "the material library is": partial(_read_library, tokens),
        }
    )


def _is_bare(data: bytes) -> bool:
    """Return whether a text is nothing but positions and vertices of faces, by its characters."""
    if data.translate(None, b"0123456789+-.eEvf \t\r\n"):
        return False
    first = data.find(b"v")
    return len(data[first : data.find(b"\n", first)].split()) < COLOURED_WORDS


def _read_uvs(tokens: Tokens, attributes: SurfaceAttributes) -> SurfaceAttributes:
    is_value = tokens.find_lines(KEYWORDS["uvs"])
    indices = _read_corner_indices(tokens, is_value, 1)
    if indices is None:
        return attributes
    heads, sizes = tokens.first_tokens[is_value], tokens.token_counts[is_value]
    if sizes.min() < 2:
        raise ValueError("a line has no number")
    values = np.zeros((len(heads), 2))
    values[:, 0] = _to_floats(tokens, heads + 1)
    values[sizes > 2, 1] = _to_floats(tokens, heads[sizes > 2] + 2)
    return attributes.add_layer("uvs", values, indices)


def _read_normals(tokens: Tokens, attributes: SurfaceAttributes) -> SurfaceAttributes:
    is_value = tokens.find_lines(KEYWORDS["normal_fans"])
    indices = _read_corner_indices(tokens, is_value, 2)
    if indices is None:
        return attributes
    # Some programs write a normal anew for each corner.
    heads, sizes = tokens.first_tokens[is_value], tokens.token_counts[is_value]
    bounds = np.stack([tokens.bounds[heads, 0], tokens.bounds[heads + sizes - 1, 1]], axis=1)
    texts = [tokens.text[begin:end] for begin, end in bounds.tolist()]
    numbers = {text: k for k, text in enumerate(dict.fromkeys(texts))}
    same = np.array([*(numbers[text] for text in texts), NONE])  # `NONE` is the last
    return replace(attributes, normal_fans=number_normal_fans(attributes.corners, same[indices]))


def _read_labels(tokens: Tokens, attributes: SurfaceAttributes) -> SurfaceAttributes:
    faces = np.flatnonzero(tokens.line_kinds == FACE)
    labels: dict[str, Any] = {
        name: _label_faces(tokens, KEYWORDS[name], faces) for name in LABEL_NAMES
    }
    objects = labels["objects"]
    parts = None if objects is None else _find_parts(tokens, attributes, objects)
    if parts is not None:
        labels["objects"] = None
    return replace(attributes, parts=parts, **labels)


def _find_parts(tokens: Tokens, attributes: SurfaceAttributes, objects: FaceLabels) -> Parts | None:
    """Return the objects as parts; None if one shares vertices with another, or they alternate."""
    indices = objects.indices
    starts = np.flatnonzero(np.diff(indices, prepend=NONE))
    if indices.min() == NONE or len(starts) != len(objects.names):
        return None
    is_vertex = tokens.line_kinds == VERTEX
    named = np.flatnonzero(tokens.find_lines(b"o"))
    before = np.cumsum(is_vertex)[named]  # vertices that are above the name of an object
    faces = np.flatnonzero(tokens.line_kinds == FACE)[starts]
    above = before[np.searchsorted(named, faces) - 1]
    lowest = np.minimum.reduceat(attributes.corners, attributes.starts[starts])
    count = int(np.count_nonzero(is_vertex))
    for first in (above, lowest):
        bounds = np.array([0, *first[1:], count])
        owners = np.searchsorted(bounds, attributes.corners, side="right") - 1
        if (np.diff(bounds) > 0).all() and (
            owners == np.repeat(indices, attributes.corner_counts)
        ).all():
            return Parts(
                names=objects.names,
                vertex_counts=np.diff(bounds),
                polygon_counts=np.diff(starts, append=len(indices)),
                transforms=np.tile(np.eye(4), (len(starts), 1, 1)),
            )
    return None


def _label_faces(tokens: Tokens, keyword: bytes, faces: Integers) -> FaceLabels | None:
    """Return the names that the lines of a keyword give the faces after them."""
    lines = np.flatnonzero(tokens.find_lines(keyword))
    if not len(lines):
        return None
    texts = ["", *(_join_words(tokens, line) for line in lines.tolist())]
    if keyword == KEYWORDS["smoothing"]:
        texts = ["" if text in ("off", "0") else text for text in texts]
    names = tuple(dict.fromkeys(text for text in texts if text))
    numbers = {name: k for k, name in enumerate(names)} | {"": NONE}
    labels = np.array([numbers[text] for text in texts])[np.searchsorted(lines, faces)]
    return None if (labels == NONE).all() else FaceLabels(names, labels)


def _read_library(tokens: Tokens, attributes: SurfaceAttributes) -> SurfaceAttributes:
    lines = np.flatnonzero(tokens.find_lines(b"mtllib"))
    names = " ".join(_join_words(tokens, line) for line in lines.tolist())
    return replace(attributes, material_library=names)


def _read_colours(tokens: Tokens, attributes: SurfaceAttributes) -> SurfaceAttributes:
    is_vertex = tokens.line_kinds == VERTEX
    size = int(tokens.token_counts[is_vertex].min())
    if size < COLOURED_WORDS:
        return attributes
    count = size - 4
    heads = tokens.first_tokens[is_vertex]
    columns = [_to_floats(tokens, heads + 4 + k) for k in range(min(count, 4))]
    return replace(attributes, colours=np.stack(columns, axis=1))


def _to_floats(tokens: Tokens, words: Integers) -> Floats:
    """Convert words by their numbers."""
    found = convert_words(tokens.text, tokens.bounds[words], np.float64)
    if found is None:
        raise ValueError("a word is no finite number")
    return found


def _join_words(tokens: Tokens, line: int) -> str:
    """Return the words of a line behind the first, as text."""
    text = b" ".join(tokens.split_line(line)[1:])
    try:
        return single_line(text.decode())
    except UnicodeDecodeError:
        return single_line(text.decode("latin-1"))


def _read_corner_indices(
    tokens: Tokens, is_value: NDArray[np.bool_], place: int
) -> Integers | None:
    """Return index `place` of every corner, from 0, or `NONE`; None if no corner has one.

    Parameters
    ----------
    is_value : (l,) bool
        The lines that are counted; without any, indices have no meaning and are not read.
    place : int
        1 for texture coordinates, 2 for normals.
    """
    is_face, sizes = tokens.line_kinds == FACE, tokens.token_counts
    is_corner = np.repeat(is_face, sizes)
    is_corner[tokens.first_tokens] = False
    parts = tokens.find_part(tokens.bounds[is_corner], place)
    is_given = parts[:, 1] > parts[:, 0]
    if not is_value.any() or not is_given.any():
        return None
    found = convert_words(tokens.text, parts[is_given], np.int64)
    if found is None:
        raise ValueError("an index is no number")
    known = np.repeat(np.cumsum(is_value)[is_face], sizes[is_face] - 1)[is_given]
    given, count = np.where(found > 0, found - 1, known + found), np.count_nonzero(is_value)
    is_wrong = (found == 0) | (given < 0) | (given >= count)
    if is_wrong.any():
        raise ValueError(f"a corner names number {found[is_wrong][0]} of {count}")
    indices = np.full(len(parts), NONE)
    indices[is_given] = given
    return indices


def read_material_colours(path: Path, mesh: FileMesh) -> FileMesh:
    """Return a mesh with the colours of its materials, if the file at `path` names a library.

    A library that is damaged is left out, with a note; one that is missing, without.
    """
    attributes = mesh.attributes
    if attributes is None or attributes.materials is None or not attributes.material_library:
        return mesh
    try:
        found: dict[str, list[float]] = {}
        left = MAX_LIBRARY_BYTES
        for library in _find_libraries(path.parent, attributes.material_library):
            data = read_input(library, left, may_be_empty=True)
            left -= len(data)
            found |= _parse_library(data)
        names = attributes.materials.names
        if not found.keys() & set(names):
            return mesh
        colours = np.array([found.get(name, PLAIN_COLOUR) for name in names])
        return replace(mesh, attributes=replace(attributes, material_colours=colours))
    except (FileAccessError, FormatError, ValueError) as error:
        note = f"the colours of its materials are left out (the library {error})"
        return replace(mesh, left_out=(*mesh.left_out, note))


def _find_libraries(folder: Path, text: str) -> list[Path]:
    """Return the files that a text names and that are there: one, whose name may have spaces, or
    several.
    """
    # `Path.exists` raises for names that the system refuses, such as ones that are too long.
    names = [text] if os.path.exists(folder / text) else text.split()
    libraries = [folder / name.replace("\\", "/") for name in dict.fromkeys(names)]
    for library in libraries:
        if not library.resolve().is_relative_to(folder.resolve()):
            raise FileAccessError("is in another folder, expected one beside the mesh")
    return [library for library in libraries if os.path.exists(library)]


def _parse_library(data: bytes) -> dict[str, list[float]]:
    """Return red, green, blue and opacity of the materials, by their names."""
    colours: dict[str, list[float]] = {}
    colour = list(PLAIN_COLOUR)  # of lines before the first name
    for number, line in enumerate(data.decode("utf-8", "replace").splitlines(), start=1):
        key, *words = line.split() or [""]
        if key == "newmtl":
            colour = colours.setdefault(" ".join(words), list(PLAIN_COLOUR))
        elif key == "Kd" and words[:1] not in (["spectral"], ["xyz"]):
            colour[:3] = _read_numbers(words, 3, number)
        elif key in ("d", "Tr"):
            (share,) = _read_numbers([word for word in words if word != "-halo"], 1, number)
            colour[3] = share if key == "d" else 1 - share
    return colours


def _read_numbers(words: list[str], count: int, line: int) -> list[float]:
    """Return the first numbers of a line, from 0 to 1; one for all three is repeated."""
    try:
        values = [float(word) for word in words[:count]]
    except ValueError:
        values = []
    if len(values) == 1:
        values *= count
    if len(values) != count or not np.isfinite(values).all():
        raise FormatError(f"has no {'colour' if count > 1 else 'number'} in line {line}")
    return [min(max(value, 0.0), 1.0) for value in values]


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
        self._shaded = animation.rest.shaded

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
    words, changes = list(_write_corners(attributes)), _write_label_changes(attributes)
    lines: list[str] = []
    starts, counts = attributes.starts.tolist(), attributes.corner_counts.tolist()
    for number, (start, count) in enumerate(zip(starts, counts, strict=True)):
        lines += changes.get(number, ())
        lines.append(f"f {' '.join(words[start : start + count])}\n")
    return head.encode() + "".join(lines).replace("%", "%%").encode()


def encode_exact_obj(vertices: Floats, polygons: Iterable[Integers]) -> bytes:
    """Return the OBJ text of polygons whose vertices are read back to the last bit."""
    lines = b"v %r %r %r\n" * len(vertices) % tuple(vertices.ravel().tolist())
    faces = (" ".join(map(str, (ring + 1).tolist())) for ring in polygons)
    return lines + "".join(f"f {face}\n" for face in faces).encode()


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
    for name in (name for name in KEYWORDS if name in LABEL_NAMES):
        labels = objects if name == "objects" else getattr(attributes, name)
        if labels is None:
            continue
        keyword, none = KEYWORDS[name].decode(), "off" if name == "smoothing" else "default"
        for number in np.flatnonzero(np.diff(labels.indices, prepend=NONE)).tolist():
            index = int(labels.indices[number])
            text = "" if index == NONE else _clean_name(labels.names[index])
            found.setdefault(number, []).append(f"{keyword} {text or none}\n")
    return found


def _clean_name(name: str) -> str:
    """Return a name without what OBJ takes for a comment, or for a line that continues."""
    name = name.replace("#", "_")
    return name[:-1] + "_" if name.endswith("\\") else name
