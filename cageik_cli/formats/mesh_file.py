"""One mesh out of one file: by our own readers, but for ASCII PLY by trimesh."""

import hashlib
import io
import logging
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cageik_cli.formats.base.file_names import GZIP_SUFFIX, decompress, file_suffix
from cageik_cli.formats.base.polygons import (
    FileMesh,
    fan_triangulate,
    fan_triangulate_polygons,
    replace_folded_fans,
)
from cageik_cli.formats.base.registry import discover_plugins
from cageik_cli.formats.base.writer import Animation, FrameFileWriter
from cageik_cli.formats.obj.parse import parse_obj
from cageik_cli.formats.off import parse_off
from cageik_cli.formats.ply import is_binary_ply, parse_binary_ply
from cageik_cli.formats.scene import Scene
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import InputError, error_context
from cageik_cli.util.outputs import check_writable, write_bytes
from cageik_cli.util.text import to_unicode

_UNCOMPRESSED_SUFFIXES = (".obj", ".ply", ".off")
MESH_SUFFIXES = (
    *_UNCOMPRESSED_SUFFIXES,
    *(suffix + GZIP_SUFFIX for suffix in _UNCOMPRESSED_SUFFIXES),
)

# Where a PLY header announces how many vertices and faces follow.
_PLY_COUNTS = re.compile(rb"(?ms)^element vertex (\d+)\s.*?^element face (\d+)\s")


@dataclass(frozen=True, slots=True, eq=False)
class LoadedMesh:
    """A mesh and where it came from.

    Attributes
    ----------
    mesh : TriMesh
    fan_triangulated : TriMesh
        The same with every polygon as a fan: what connectivity is compared by.
    source : dict
        `name` and `sha256` of the file; the name alone of a frame of the clip.
    notes : tuple of str
        What was changed, one sentence each.
    obj_text : bytes
        An OBJ file as it is, unpacked; empty for other kinds.
    """

    mesh: TriMesh
    fan_triangulated: TriMesh
    source: dict[str, str]
    notes: tuple[str, ...] = ()
    obj_text: bytes = b""


def load_mesh(path: Path) -> LoadedMesh:
    """Read one mesh; polygons are triangulated, and said so.

    Raises
    ------
    InputError
        Naming the file, when it is missing, not a mesh, or not of a kind we read.
    """
    with error_context(path):
        if path.is_dir():
            raise InputError("is a folder, expected a file; name a mesh in it")
        kind = file_suffix(path)
        if kind not in MESH_SUFFIXES:
            raise InputError(
                f"`{kind}` is not a kind of mesh read here, expected {', '.join(MESH_SUFFIXES)}"
            )
        data = read_bytes(path)
        content = decompress(data, kind)
        mesh = parse_mesh(content, kind)
        fan_triangulated = mesh.fan_triangulated
        return LoadedMesh(
            mesh=replace_folded_fans(fan_triangulated, mesh.corner_counts),
            fan_triangulated=fan_triangulated,
            source=describe_source(path, data),
            notes=mesh.notes,
            obj_text=content if kind.removesuffix(GZIP_SUFFIX) == ".obj" else b"",
        )


def read_bytes(path: Path) -> bytes:
    """The whole file, or a sentence on why it cannot be read."""
    if path.is_dir():
        raise InputError("is a folder, expected a file")
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}") from error


def describe_source(path: Path, data: bytes) -> dict[str, str]:
    """What is recorded of a file that was read: its name and digest."""
    return {"name": to_unicode(path.name), "sha256": hashlib.sha256(data).hexdigest()}


def parse_mesh(data: bytes, kind: str) -> FileMesh:
    """The mesh in the bytes, unpacked, of a mesh file of some kind."""
    suffix = kind.removesuffix(GZIP_SUFFIX)
    if suffix == ".obj":
        return parse_obj(data)
    if not data:
        raise InputError("the file is empty, expected a mesh; export it again")
    if is_binary_ply(data):
        vertices, corners, sizes = parse_binary_ply(data)
        return FileMesh(vertices, fan_triangulate(corners, sizes), sizes)
    vertices, polygons = parse_off(data) if suffix == ".off" else _parse_ply_with_trimesh(data)
    return FileMesh(vertices, *fan_triangulate_polygons(polygons))


def _parse_ply_with_trimesh(data: bytes) -> tuple[Floats, list[Integers]]:
    from trimesh.exchange.ply import load_ply

    # Its loader may log a traceback of its own before it raises.
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    try:
        loaded = load_ply(io.BytesIO(data), fix_texture=False, skip_materials=True)
        # Its own triangles tell neither polygons nor their order.
        faces = loaded["metadata"]["_ply_raw"].get("face", {"length": 0})
        lists = faces["data"] if faces["length"] else {"none": []}
        name = next(name for name in ("vertex_indices", "vertex_index", *lists) if name in lists)
        vertices, polygons = np.asarray(loaded["vertices"]), list(lists[name])
    except Exception as error:  # whatever a damaged file makes trimesh raise
        raise InputError(f"no PLY mesh can be read from it: {error}") from error
    announced = _PLY_COUNTS.search(data)
    counts = (len(vertices), len(polygons))
    if announced is not None and counts != tuple(map(int, announced.groups())):
        raise InputError(
            f"announces {int(announced[1])} vertices and {int(announced[2])} faces, holds "
            f"{counts[0]} and {counts[1]}; it is cut short, export it again"
        )
    return vertices, polygons


def check_mesh_output(path: Path, overwrite: bool) -> None:
    """Refuse, before any work, a mesh of no known kind, that exists or cannot be written.

    Raises
    ------
    InputError
        Naming the output and what to do.
    """
    _choose_mesh_writer(path)
    check_writable(path, overwrite)


def write_mesh(
    path: Path, mesh: TriMesh, positions: Floats, overwrite: bool, obj_text: bytes = b""
) -> None:
    """Write a mesh at other positions, (m, 3), as animations of files do.

    Parameters
    ----------
    path, mesh, positions, overwrite
    obj_text : bytes
        As of `Animation`.

    Raises
    ------
    InputError
        When it cannot be written.
    """
    animation = Animation(mesh, 1, Scene(start=0), path.stem, obj_text)
    writer = _choose_mesh_writer(path)(path.with_name(f"_####{path.suffix.lower()}"), animation)
    write_bytes(path, writer.encode_frame(positions), overwrite)


def _choose_mesh_writer(path: Path) -> type[FrameFileWriter]:
    """The writer of files of one frame by the suffix."""
    found = discover_plugins("Writer").items()
    kinds: dict[str, type[FrameFileWriter]] = {
        suffix: kind for suffix, kind in found if issubclass(kind, FrameFileWriter)
    }
    kind = kinds.get(path.suffix.lower())
    if kind is None:
        raise InputError(
            f"{path}: `{path.suffix}` is not a kind of mesh written here, expected "
            f"{', '.join(kinds)}"
        )
    return kind
