"""One mesh out, as a file of the kinds that hold one."""

from pathlib import Path

from cageik_cli.export import writers
from cageik_cli.export.animation import Animation
from cageik_cli.export.frame_files import FrameFileWriter
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.kinds import by_suffix
from cageik_cli.scene import Scene
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import InputError
from cageik_cli.util.outputs import prepare, write_bytes


def prepare_mesh(path: Path, overwrite: bool) -> None:
    """Refuse, before any work, a mesh of no known kind, that exists or cannot be written.

    Raises
    ------
    InputError
        Naming the output and what to do.
    """
    _kind(path)
    prepare(path, overwrite)


def write_mesh(
    path: Path, mesh: TriMesh, positions: Floats, overwrite: bool, text: bytes = b""
) -> None:
    """Write a mesh at other positions, (m, 3), as animations of files do.

    Parameters
    ----------
    path, mesh, positions, overwrite
    text : bytes
        As of `Animation`.

    Raises
    ------
    InputError
        When it cannot be written.
    """
    animation = Animation(mesh, 1, Scene(start=0), path.stem, text)
    writer = _kind(path)(path.with_name(f"_####{path.suffix.lower()}"), animation)
    write_bytes(path, writer.content(positions), overwrite)


def _kind(path: Path) -> type[FrameFileWriter]:
    """The writer of files of one frame by the suffix."""
    found = by_suffix(writers, "Writer").items()
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
