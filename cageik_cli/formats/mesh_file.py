"""One mesh in and out, in the formats that hold one mesh per file."""

from pathlib import Path

from cageik_cli.formats.base.file_data import decompress, describe_source
from cageik_cli.formats.base.file_names import file_suffix
from cageik_cli.formats.base.frame_files import FrameFileReader, parse_mesh
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.base.registry import discover_plugins
from cageik_cli.formats.base.writer import Animation, FrameFileWriter
from cageik_cli.formats.scene import Scene
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FileAccessError, OutputError, error_context
from cageik_cli.util.files import read_input
from cageik_cli.util.outputs import check_writable, write_bytes


def mesh_suffixes() -> tuple[str, ...]:
    """Return the suffixes of the mesh files that can be read."""
    return tuple(_find_mesh_readers())


def load_mesh(path: Path) -> LoadedMesh:
    """Read one mesh; polygons are cut into triangles, with a note.

    Raises
    ------
    FileAccessError, FormatError
        Naming the file, when it is missing, not a mesh, or of an unknown format.
    """
    with error_context(path):
        if path.is_dir():
            raise FileAccessError("is a folder, expected a file; give a mesh in it")
        suffix, readers = file_suffix(path), _find_mesh_readers()
        if suffix not in readers:
            raise FileAccessError(
                f"`{suffix}` is not a mesh format that can be read, expected {', '.join(readers)}"
            )
        data = read_input(path)
        content = decompress(data, suffix)
        reader = readers[suffix]
        mesh = reader.read_attributes(content, parse_mesh(reader, content))
        mesh = reader.read_library(path, mesh)
        return LoadedMesh(mesh.make_mesh(), describe_source(path, data), mesh.notes)


def check_mesh_output(path: Path, overwrite: bool) -> None:
    """Refuse, before any work, a mesh file that cannot be written.

    Raises
    ------
    OutputError
        When its format is unknown, it exists, or its folder cannot be written.
    """
    _choose_mesh_writer(path)
    check_writable(path, overwrite)


def write_mesh(path: Path, mesh: TriMesh, positions: Floats, overwrite: bool) -> None:
    """Write a mesh at other positions, (m, 3), as animations of one file per frame are written.

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    animation = Animation(mesh, 1, Scene(start=0), path.stem)
    writer = _choose_mesh_writer(path)(path.with_name(f"_####{path.suffix.lower()}"), animation)
    write_bytes(path, writer.encode_frame(positions), overwrite)


def _find_mesh_readers() -> dict[str, type[FrameFileReader]]:
    """Return the readers of files of one mesh, by suffix."""
    found = discover_plugins("Reader").items()
    return {suffix: kind for suffix, kind in found if issubclass(kind, FrameFileReader)}


def _choose_mesh_writer(path: Path) -> type[FrameFileWriter]:
    """Return the writer of files of one mesh for the path's suffix."""
    found = discover_plugins("Writer").items()
    writers: dict[str, type[FrameFileWriter]] = {
        suffix: kind for suffix, kind in found if issubclass(kind, FrameFileWriter)
    }
    writer = writers.get(path.suffix.lower())
    if writer is None:
        raise OutputError(
            f"{path}: `{path.suffix}` is not a mesh format that can be written, expected "
            f"{', '.join(writers)}"
        )
    return writer
