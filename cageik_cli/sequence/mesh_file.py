"""One mesh out of one file: OBJ by our own reader, PLY and OFF by trimesh."""

import hashlib
import io
import logging
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cageik_cli.errors import InputError, located
from cageik_cli.layout import printable
from cageik_cli.mesh import Floats, Integers, TriMesh
from cageik_cli.sequence.obj import FileMesh, parse_obj

MESH_SUFFIXES = (".obj", ".ply", ".off")

# Where the headers announce how many vertices and faces follow.
_DECLARED = {
    ".ply": re.compile(rb"(?ms)^element vertex (\d+)\s.*?^element face (\d+)\s"),
    ".off": re.compile(rb"(?m)^[ \t]*(?:OFF[ \t]+)?(\d+)[ \t]+(\d+)[ \t]+\d+\s"),
}


@dataclass(frozen=True, slots=True, eq=False)
class LoadedMesh:
    """A mesh and where it came from.

    Attributes
    ----------
    mesh : TriMesh
    source : dict
        `name` and `sha256` of the file; the name alone of a frame of the clip.
    notes : tuple of str
        What was changed, one sentence each.
    """

    mesh: TriMesh
    source: dict[str, str]
    notes: tuple[str, ...] = ()


def load_mesh(path: Path) -> LoadedMesh:
    """Read one mesh; polygons are triangulated, and said so.

    Raises
    ------
    InputError
        Naming the file, when it is missing, not a mesh, or not of a kind we read.
    """
    with located(path):
        if path.suffix.lower() not in MESH_SUFFIXES:
            raise InputError(
                f"`{path.suffix}` is not a kind of mesh read here, expected "
                f"{', '.join(MESH_SUFFIXES)}"
            )
        data = read_bytes(path)
        mesh = file_mesh(data, path.suffix.lower())
        return LoadedMesh(TriMesh(mesh.vertices, mesh.faces), source_of(path, data), mesh.notes)


def read_bytes(path: Path) -> bytes:
    """The whole file, or a sentence on why it cannot be read."""
    if path.is_dir():
        raise InputError("is a folder, expected a file")
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}") from error


def source_of(path: Path, data: bytes) -> dict[str, str]:
    """What is recorded of a file that was read: its name and digest."""
    return {"name": printable(path.name), "sha256": hashlib.sha256(data).hexdigest()}


def file_mesh(data: bytes, suffix: str) -> FileMesh:
    """The mesh in a mesh file's bytes; `suffix` says of what kind."""
    if suffix == ".obj":
        return parse_obj(data)
    if not data:
        raise InputError("the file is empty, expected a mesh; export it again")
    vertices, faces = _by_trimesh(data, suffix[1:])
    declared = _DECLARED[suffix].search(data)
    count, polygons = map(int, declared.groups()) if declared else (len(vertices), len(faces))
    if len(vertices) != count or len(faces) < polygons:
        raise InputError(
            f"announces {count} vertices and {polygons} faces, holds {len(vertices)} and "
            f"{len(faces)}; it is cut short, export it again"
        )
    return FileMesh(vertices, faces, len(faces) - polygons)


def _by_trimesh(data: bytes, kind: str) -> tuple[Floats, Integers]:
    import trimesh

    # Its loaders log a traceback of their own before they raise.
    trimesh.util.log.setLevel(logging.CRITICAL)
    options = {"fix_texture": False} if kind == "ply" else {}
    try:
        mesh = trimesh.load_mesh(
            io.BytesIO(data), file_type=kind, process=False, maintain_order=True, **options
        )
        return np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64)
    except Exception as error:  # whatever a damaged file makes trimesh raise
        raise InputError(f"no {kind.upper()} mesh can be read from it: {error}") from error
