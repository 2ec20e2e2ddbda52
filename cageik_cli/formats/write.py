"""Write animations: from the name of an output to its writer."""

import json
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cageik_cli.formats.base.file_numbers import FrameNames
from cageik_cli.formats.base.files import discover_plugins
from cageik_cli.formats.base.writers import (
    Animation,
    AnimationWriter,
    FrameFileWriter,
    get_positions,
    shift_positions,
)
from cageik_cli.formats.settings import Scene
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import OutputError, error_context
from cageik_cli.util.outputs import (
    atomic_folder,
    atomic_path,
    check_folder_writable,
    check_writable,
    write_bytes,
)
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import format_bytes

DEFAULT_FORMAT = "obj"
"""Format of the files in a folder, when none is given."""

DEFAULT_DIGITS = 4
"""Digits of the frame numbers of files in a folder, when no pattern is given."""

MAX_ROUNDING = 1e-5
"""Rounding to single precision is noted above it, in diagonals."""

WriterFactory = Callable[[Path, Animation], AnimationWriter]


def check_animation_output(path: Path, overwrite: bool, file_format: str | None = None) -> None:
    """Refuse, before any work, an output that cannot be written.

    Parameters
    ----------
    path : Path
        A file; files in a folder by a pattern, see `FrameNames`; or a folder alone, whose files
        get its name and a number.
    overwrite : bool
        Whether an existing file, or a folder of such files and no others, may be replaced.
    file_format : str, optional
        Format of the files when only a folder is given: their suffix without the dot.

    Raises
    ------
    InputError
        Naming the output and what to do.
    """
    target = _resolve_target(path, file_format)
    with error_context(path):
        target.writer.require_libraries()
    if target.frame_names is None:
        check_writable(path, overwrite)
    else:
        check_folder_writable(target.path, overwrite, target.frame_names.matches)


def output_path(path: Path, file_format: str | None = None) -> Path:
    """Return the file or the folder that is written for the output `path`."""
    return _resolve_target(path, file_format).path


def frame_formats() -> tuple[str, ...]:
    """Return the names of the formats of folders of frames: their suffixes without the dot."""
    writers = _find_writers().items()
    return tuple(suffix[1:] for suffix, writer in writers if writer.writes_folder)


@contextmanager
def open_writer(
    path: Path,
    animation: Animation,
    overwrite: bool,
    file_format: str | None = None,
    writer_factory: WriterFactory | None = None,
) -> Iterator[AnimationWriter]:
    """Open a writer for `path`; the output gets its name if the block ends without an error.

    Parameters
    ----------
    path, overwrite, file_format
        As of `check_animation_output`.
    writer_factory : callable, optional
        Makes the writer, instead of the usual one of that suffix.

    Raises
    ------
    InputError
        When it cannot be written, or cannot hold the animation.
    """
    target = _resolve_target(path, file_format)
    with target.open_atomic(overwrite) as name:
        with error_context(path):
            writer = (writer_factory or target.writer)(name, animation)
        try:
            yield writer
            with error_context(path):
                writer.complete()
        except BaseException:
            with suppress(Exception):  # the first error says what is wrong
                writer.abandon()
            raise


@dataclass(frozen=True, slots=True)
class _Target:
    """An output and its writer.

    Attributes
    ----------
    path : Path
        The file or the folder that is written.
    frame_names : FrameNames, optional
        Of the files in a folder.
    """

    path: Path
    writer: type[AnimationWriter]
    frame_names: FrameNames | None

    def open_atomic(self, overwrite: bool) -> AbstractContextManager[Path]:
        """Yield a temporary name for the writer; the output is renamed when it is complete."""
        if self.frame_names is None:
            return atomic_path(self.path, overwrite)
        return self._open_atomic_folder(self.frame_names, overwrite)

    @contextmanager
    def _open_atomic_folder(self, names: FrameNames, overwrite: bool) -> Iterator[Path]:
        with atomic_folder(self.path, overwrite, names.matches) as folder:
            yield folder / names.pattern


def _resolve_target(path: Path, file_format: str | None) -> _Target:
    with error_context(path):
        names, folder = FrameNames.parse(path.name), path.parent
        suffix, kinds = _find_suffix(path, file_format), _find_writers()
        if _is_folder(path, file_format):
            names, folder = FrameNames(f"{path.name}_", DEFAULT_DIGITS, suffix), path
        if suffix not in kinds:
            raise OutputError(
                f"`{path.suffix}` is not an animation format that can be written, expected "
                f"{', '.join(kinds)}"
            )
        writer = kinds[suffix]
        if file_format and suffix != f".{file_format}":
            raise OutputError(f"has another suffix than --format {file_format}; remove --format")
        if writer.writes_folder and names is None:
            raise OutputError(
                f"a `{suffix}` file holds one frame; name files in a folder, "
                f"such as {path.stem}/{path.stem}_####{suffix}"
            )
        if names is not None and not writer.writes_folder:
            raise OutputError(f"a `{suffix}` file holds all frames; remove the frame number")
    return _Target(path if names is None else folder, writer, names)


def _is_folder(path: Path, file_format: str | None) -> bool:
    """Return whether an output is a folder alone, whose files get its name."""
    if FrameNames.parse(path.name) is not None:
        return False
    return not path.suffix or (
        file_format is not None and path.suffix.lower() not in _find_writers()
    )


def _find_suffix(path: Path, file_format: str | None) -> str:
    """Return the suffix of an output, or of its files, in lower case; also an unknown one."""
    is_folder = _is_folder(path, file_format)
    return f".{file_format or DEFAULT_FORMAT}" if is_folder else path.suffix.lower()


def _find_writers() -> dict[str, type[AnimationWriter]]:
    """Return the writers by the suffixes that they take."""
    return discover_plugins("Writer")


@dataclass(frozen=True, slots=True)
class Output:
    """The output of an animation.

    Attributes
    ----------
    overwrite : bool
        As of `check_animation_output`.
    recentre : bool
        Whether the animation is moved to the origin, and the offset written beside it.
    """

    path: Path
    file_format: str | None = None
    overwrite: bool = False
    recentre: bool = False

    @property
    def target_path(self) -> Path:
        """The file or the folder that is written."""
        return output_path(self.path, self.file_format)

    @property
    def offset_path(self) -> Path:
        """The file beside it that holds the offset of an animation that was moved."""
        return self.target_path.with_name(f"{self.target_path.name}.offset.json")

    def list_paths(self) -> list[Path]:
        """Return the files and folders that are written."""
        return [self.target_path, *([self.offset_path] if self.recentre else [])]

    @property
    def suffix(self) -> str:
        """The suffix of the file, or of the files in the folder, in lower case."""
        return _find_suffix(self.path, self.file_format)

    @property
    def has_format(self) -> bool:
        """Whether a format is asked for; otherwise the model decides."""
        is_named = FrameNames.parse(self.path.name) is not None or bool(self.path.suffix)
        return is_named or self.file_format is not None

    def check_writable(self) -> None:
        """Refuse, before any work, what cannot be written; see `check_animation_output`."""
        check_animation_output(self.path, self.overwrite, self.file_format)
        if self.recentre:
            check_writable(self.offset_path, self.overwrite)


@dataclass(frozen=True, slots=True)
class ExportSummary:
    """What was written: counts and size.

    Attributes
    ----------
    path : Path
        As the user named it.
    byte_count : int
        Bytes, of all files.
    parts : str
        What is counted, in words.
    """

    path: Path
    frame_count: int
    vertex_count: int
    byte_count: int
    parts: str = "vertices"

    @property
    def message(self) -> str:
        """A line for the user."""
        counts = f"{self.frame_count} frames of {self.vertex_count} {self.parts}"
        return f"wrote {self.path}: {counts}, {format_bytes(self.byte_count)}"


def write_animation(
    output: Output,
    animation: Animation,
    blocks: Iterator[Floats],
    progress: ProgressListener,
    writer_factory: WriterFactory | None = None,
) -> ExportSummary:
    """Write all `blocks` of frames, (k, m, 3), in order, and report the notes of the writer.

    Raises
    ------
    InputError
        When it cannot be written, or cannot hold the animation.
    """
    path, done, largest = output.path, 0, 0.0
    if output.recentre:
        animation = animation.recentre()
    origin = np.array(animation.origin)
    with open_writer(
        path, animation, output.overwrite, output.file_format, writer_factory
    ) as writer:
        while True:
            with progress.stage("export"):
                block = next(blocks, None)
                if block is None:
                    break
                if output.recentre:
                    block = shift_positions(block, -origin)
                with error_context(path):
                    writer.append(block)
                if writer.is_single:
                    largest = max(largest, _find_largest(get_positions(block)))
            done += len(block)
            progress.update(done, animation.frame_count)
    if output.recentre:
        write_bytes(output.offset_path, _encode_offset(animation.origin), output.overwrite)
        progress.note("note", f"{path.name}: moved to the origin, offset in {output.offset_path}")
    for note in (*writer.notes, *_list_rounding_notes(writer, largest, animation.rest.diagonal)):
        progress.note("note", f"{path.name}: {note}")
    return ExportSummary(path, done, len(animation.rest.vertices), _total_size(output.target_path))


def _find_largest(positions: Floats) -> float:
    """Return the largest magnitude of a coordinate, without an array of magnitudes."""
    return float(max(positions.max(), -positions.min()))


def _encode_offset(origin: tuple[float, float, float]) -> bytes:
    """Return the JSON file that holds what is to be added to every position."""
    return (json.dumps({"offset": origin}) + "\n").encode()


def _list_rounding_notes(
    writer: AnimationWriter, largest: float, diagonal: float
) -> tuple[str, ...]:
    """Return a note if the format rounds coordinates up to `largest` by more than is usual."""
    if not writer.is_single:
        return ()
    rounding = float(np.spacing(np.float32(largest))) / 2
    if rounding <= MAX_ROUNDING * diagonal:
        return ()
    return (
        f"coordinates of up to {largest:.3g} are rounded by up to {rounding:.2g}, "
        f"{100 * rounding / diagonal:.2g} % of the diagonal, as the format has single precision; "
        "--recentre of cageik export and deform moves them to the origin and writes the offset "
        "beside",
    )


def _total_size(path: Path) -> int:
    files = path.iterdir() if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files)


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
