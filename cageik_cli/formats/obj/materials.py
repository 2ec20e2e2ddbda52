"""The colours of the materials of an OBJ file, from the library (`.mtl`) that it names."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.geometry.surface_parts import PLAIN_COLOUR
from cageik_cli.util.errors import FileAccessError, FormatError
from cageik_cli.util.files import read_input

MAX_LIBRARY_BYTES = 1 << 24
"""Bytes of all libraries of materials that are read: a hundred thousand materials."""


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

    Raises
    ------
    FileAccessError
        When one is outside the folder of the mesh.
    """
    names = [text] if _is_there(folder / text) else text.split()
    libraries = [folder / name.replace("\\", "/") for name in dict.fromkeys(names)]
    for library in libraries:
        if not library.resolve().is_relative_to(folder.resolve()):
            raise FileAccessError("is in another folder, expected one beside the mesh")
    return [library for library in libraries if _is_there(library)]


def _is_there(path: Path) -> bool:
    """Tell whether there is a file; there is none of a name that the system does not accept."""
    try:
        return path.exists()
    except OSError:
        return False


def _parse_library(data: bytes) -> dict[str, list[float]]:
    """Return red, green, blue and opacity of the materials, by their names.

    Raises
    ------
    FormatError
        When a colour is no three numbers, or an opacity no number.
    """
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
