"""UVs, normals, names of faces and colours of vertices in an OBJ text; colours in its library."""

import codecs
import os
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.formats.obj.text import FACE, VERTEX, Tokens, blank_out, convert_words, tokenize
from cageik_cli.geometry.attributes import (
    NONE,
    PLAIN_COLOUR,
    FaceLabels,
    Parts,
    SurfaceAttributes,
    UvMap,
    number_normal_fans,
)
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FileAccessError, FormatError
from cageik_cli.util.files import read_input
from cageik_cli.util.text import single_line

COLOURED_WORDS = 7
"""Words of a line of a vertex with a colour; a fourth number alone is a weight."""

MAX_LIBRARY_BYTES = 1 << 24
"""Bytes of all libraries of materials that are read: a hundred thousand materials."""


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
    is_value = tokens.find_lines(b"vt")
    indices = _read_corner_indices(tokens, is_value, 1)
    if indices is None:
        return attributes
    heads, sizes = tokens.first_tokens[is_value], tokens.token_counts[is_value]
    if sizes.min() < 2:
        raise ValueError("a line has no number")
    values = np.zeros((len(heads), 2))
    values[:, 0] = _to_floats(tokens, heads + 1)
    values[sizes > 2, 1] = _to_floats(tokens, heads[sizes > 2] + 2)
    return replace(attributes, uvs=UvMap(values, indices))


def _read_normals(tokens: Tokens, attributes: SurfaceAttributes) -> SurfaceAttributes:
    is_value = tokens.find_lines(b"vn")
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
    objects = _label_faces(tokens, b"o", faces)
    parts = None if objects is None else _find_parts(tokens, attributes, objects)
    return replace(
        attributes,
        materials=_label_faces(tokens, b"usemtl", faces),
        groups=_label_faces(tokens, b"g", faces),
        objects=objects if parts is None else None,
        smoothing=_label_faces(tokens, b"s", faces),
        parts=parts,
    )


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
    if keyword == b"s":
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
            data = read_input(library, left)
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
