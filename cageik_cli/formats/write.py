"""Write animations and meshes: from the name of an output to its writer.

A name with `{part}` stands for a file of each part of a model.
"""

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cageik_cli.formats.base.file_numbers import FrameNames
from cageik_cli.formats.base.files import discover_plugins
from cageik_cli.formats.base.writers import (
    Animation,
    AnimationWriter,
    FrameFileWriter,
    choose_short_names,
    get_positions,
    shift_positions,
)
from cageik_cli.formats.scene_conversion import SceneConversion
from cageik_cli.formats.settings import Scene
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import Part, join_meshes, split_parts
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import OutputError, SettingError, error_context, join_truncated
from cageik_cli.util.messages import Hint, Note, Said, say
from cageik_cli.util.outputs import (
    atomic_folder,
    atomic_path,
    check_folder_writable,
    check_writable,
    make_folder,
    write_bytes,
)
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import (
    format_bytes,
    format_count,
    group_digits,
    make_file_name,
    number_file_names,
)
from cageik_cli.util.units import list_size_notes

DEFAULT_FORMAT = "obj"
"""Format of the files in a folder, when none is given."""

MAX_ROUNDING = 1e-5
"""Rounding to single precision is noted above it, in diagonals."""

WriterFactory = Callable[[Path, Animation], AnimationWriter]

PLACEHOLDER = "{part}"
"""Stands for the name of a part."""

NO_NUMBERS = str.maketrans("/#%$", "____")
"""What is replaced in the names of parts: `####`, `%04d` and `$F4` stand for numbers of frames."""


@dataclass(frozen=True, slots=True)
class Output:
    """The output of an animation, and how it gets its name.

    Attributes
    ----------
    path : Path
        A file; files in a folder by a pattern, see `FrameNames`; or a folder alone, whose files
        get its name and a number.
    file_format : str, optional
        Format of the files when only a folder is given: their suffix without the dot.
    overwrite : bool
        Whether an existing file, or a folder of such files and no others, may be replaced.
    recentre : bool
        Whether the animation is moved to the origin, and the offset written beside it.
    makes_folder : bool
        Whether the folder that it is in is created, as for the files of parts.
    """

    path: Path
    file_format: str | None = None
    overwrite: bool = False
    recentre: bool = False
    makes_folder: bool = False

    @property
    def is_folder(self) -> bool:
        """Whether it is a folder alone, whose files get its name."""
        if self._typed_names is not None:
            return False
        suffix = self.path.suffix.lower()
        return not suffix or (self.file_format is not None and suffix not in _find_writers())

    @property
    def suffix(self) -> str:
        """The suffix of the file, or of the files in the folder, in lower case; may be unknown."""
        if self.is_folder:
            return f".{self.file_format or DEFAULT_FORMAT}"
        return self.path.suffix.lower()

    @property
    def frame_names(self) -> FrameNames | None:
        """The names of the files in the folder; None for a file that holds all frames."""
        if self.is_folder:
            return FrameNames(f"{self.path.name}_", digits=4, after=self.suffix)
        return self._typed_names

    @property
    def _typed_names(self) -> FrameNames | None:
        """The names of files by their pattern; a file of all frames may have a lone `#`."""
        names = FrameNames.parse(self.path.name)
        if names is None or not names.is_of_lone_hash:
            return names
        writer = _find_writers().get(self.path.suffix.lower())
        return None if writer is not None and not writer.writes_folder else names

    @property
    def has_format(self) -> bool:
        """Whether a format is asked for; otherwise the model decides."""
        is_named = self._typed_names is not None or bool(self.path.suffix)
        return is_named or self.file_format is not None

    @property
    def target_path(self) -> Path:
        """The file or the folder that is written; raises as `find_writer`."""
        self.find_writer()
        return self.path if self.is_folder or self.frame_names is None else self.path.parent

    @property
    def _is_own_name(self) -> Callable[[str], bool] | None:
        """What tells the names of files in the folder that is written; None for a file."""
        if self.frame_names is not None:
            return self.frame_names.matches
        names = self.find_writer().name_files(self.path.stem)
        return names.__contains__ if names else None

    @property
    def offset_path(self) -> Path:
        """The file beside it that holds the offset of an animation that was moved."""
        return self.target_path.with_name(f"{self.target_path.name}.offset.json")

    def list_paths(self) -> list[Path]:
        """Return the files and folders that are written."""
        return [self.target_path, *([self.offset_path] if self.recentre else [])]

    def find_writer(self) -> type[AnimationWriter]:
        """Return the writer of the format."""
        with error_context(self.path):
            names, suffix, writers = self.frame_names, self.suffix, _find_writers()
            if not suffix:
                raise OutputError(
                    "the names of the files have no suffix, which is their format; add one, such "
                    f"as {self.path.name}.{DEFAULT_FORMAT}"
                )
            if suffix not in writers:
                raise OutputError(
                    f"`{suffix}` is not an animation format that can be written, "
                    f"expected {', '.join(writers)}"
                )
            if self.file_format and suffix != f".{self.file_format}":
                raise OutputError(
                    "has another suffix than "
                    + Hint("file_format", self.file_format)
                    + say("; remove `file_format=`")
                )
            if writers[suffix].writes_folder and names is None:
                stem = self.path.stem
                raise OutputError(
                    f"a `{suffix}` file holds one frame; name files in a folder, "
                    f"such as {stem}/{stem}_####{suffix}"
                )
            if names is not None and not writers[suffix].writes_folder:
                raise OutputError(f"a `{suffix}` file holds all frames; remove the frame number")
        return writers[suffix]

    def check_writable(self) -> None:
        """Refuse, before any work, what cannot be written."""
        writer = self.find_writer()
        with error_context(self.path):
            writer.require_libraries()
        folder = self.target_path.parent
        if self.makes_folder and not folder.exists():
            check_folder_writable(folder, overwrite=False, is_output_name=lambda name: False)
            return
        if self._is_own_name is None:
            check_writable(self.path, self.overwrite)
        else:
            check_folder_writable(self.target_path, self.overwrite, self._is_own_name)
        if self.recentre:
            check_writable(self.offset_path, self.overwrite)

    @contextmanager
    def open_writer(
        self, animation: Animation, make_writer: WriterFactory | None = None
    ) -> Iterator[AnimationWriter]:
        """Open a writer; the output gets its name if the block ends without an error.

        `make_writer` makes another than the usual one of the suffix.
        """
        usual = self.find_writer()
        with self._open_unfinished() as name:
            with error_context(self.path):
                writer = (make_writer or usual)(name, animation)
            try:
                yield writer
                with error_context(self.path):
                    writer.complete()
            except BaseException:
                with suppress(Exception):  # the first error says what is wrong
                    writer.abandon()
                raise

    @contextmanager
    def _open_unfinished(self) -> Iterator[Path]:
        """Yield a temporary name for the writer; the output is renamed when it is complete."""
        names, is_own_name = self.frame_names, self._is_own_name
        with self._make_folder():
            if is_own_name is None:
                with atomic_path(self.path, self.overwrite) as path:
                    yield path
            else:
                with atomic_folder(self.target_path, self.overwrite, is_own_name) as folder:
                    yield folder / (names.pattern if names is not None else self.path.name)

    @contextmanager
    def _make_folder(self) -> Iterator[None]:
        """Create the folder that the output is in, if it does; remove it if nothing is written."""
        folder = self.target_path.parent
        if not self.makes_folder or folder.exists():
            yield
            return
        make_folder(folder)
        try:
            yield
        except BaseException:
            with suppress(OSError):  # it holds what was completed
                folder.rmdir()
            raise


def frame_formats() -> tuple[str, ...]:
    """Return the names of the formats of folders of frames: their suffixes without the dot."""
    writers = _find_writers().items()
    return tuple(suffix[1:] for suffix, writer in writers if writer.writes_folder)


def _find_writers() -> dict[str, type[AnimationWriter]]:
    """Return the writers by the suffixes that they take."""
    return discover_plugins("Writer")


@dataclass(frozen=True, slots=True)
class ExportSummary:
    """What was written: counts and size.

    Attributes
    ----------
    path : Path
        As the user named it.
    byte_count : int
        Bytes, of all files.
    unit : str
        What `vertex_count` counts, in words.
    notes : tuple of Note
        What was found on the way. Runs of the command line show them, and leave them out here.

    Examples
    --------
    >>> from cageik_cli import export, extract_to_file
    >>> walker = "data_fixtures/walker"
    >>> result = extract_to_file(f"{walker}/frames", f"{walker}/cage.obj", "walker.h5")
    >>> written = export(result, "cages.npz")
    >>> written.frame_count, written.vertex_count, written.unit
    (48, 80, 'vertices')
    """

    path: Path
    frame_count: int
    vertex_count: int
    byte_count: int
    unit: str = "vertices"
    notes: tuple[Note, ...] = ()

    @property
    def message(self) -> str:
        """A line for the user."""
        frames = format_count(self.frame_count, "frame")
        counts = f"{frames} of {group_digits(self.vertex_count)} {self.unit}"
        return f"wrote {self.path}: {counts}, {format_bytes(self.byte_count)}"


def write_animation(
    output: Output,
    animation: Animation,
    blocks: Iterator[Floats],
    progress: ProgressListener,
    make_writer: WriterFactory | None = None,
) -> ExportSummary:
    """Write all `blocks` of frames, (k, m, 3), in order, and report the notes of the writer."""
    path, done, largest = output.path, 0, 0.0
    outputs = split_output(output, animation.rest, animation.name)
    if output.recentre:
        animation = animation.recentre()
    origin = np.array(animation.origin)
    with _open_writer(output, outputs, animation, make_writer) as writer:
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
                    positions = get_positions(block)
                    largest = max(largest, float(positions.max()), -float(positions.min()))
            done += len(block)
            progress.update(done, animation.frame_count)
    if output.recentre:
        # What is to be added to every position in the file.
        conversion = SceneConversion.of_output(animation.scene, output.find_writer().space)
        offset = json.dumps({"offset": conversion.apply(origin).tolist()}) + "\n"
        for each in outputs:
            write_bytes(each.offset_path, offset.encode(), output.overwrite)
        progress.note("note", f"{path.name}: moved to the origin, offset in {output.offset_path}")
    notes = [*writer.notes, *_list_rounding_notes(largest, animation.rest.diagonal)]
    if make_writer is None:
        notes = [*_list_part_notes(outputs, output, animation), *notes]
    if writer.states_unit:
        unit = animation.scene.metres_per_unit
        notes += list_size_notes(animation.rest.diagonal, unit, "the file says that a unit is")
    for note in notes:
        progress.note("note", f"{path.name}: " + note)
    targets = [each.target_path for each in outputs]
    files = [file for one in targets for file in (one.iterdir() if one.is_dir() else [one])]
    size = sum(file.stat().st_size for file in files)
    return ExportSummary(path, done, len(animation.rest.vertices), size)


@contextmanager
def _open_writer(
    output: Output, outputs: list[Output], animation: Animation, make_writer: WriterFactory | None
) -> Iterator[AnimationWriter]:
    """Open the writer of the animation, or one of its parts, which have outputs of their own."""
    if not names_parts(output.path):
        with output.open_writer(animation, make_writer) as writer:
            yield writer
        return
    if make_writer is not None:
        raise OutputError(f"{output.path}: there are no parts to write; leave {PLACEHOLDER} out")
    with ExitStack() as stack:
        writers = []
        for part, each in zip(animation.split(), outputs, strict=True):
            own = replace(
                animation,
                rest=join_meshes([part.mesh], [part.name], [part.transform]),
                guide=animation.guide if part.name == animation.guide else "",
            )
            writers.append((part, stack.enter_context(each.open_writer(own))))
        together = _PartsWriter(writers)
        yield together
    # Known when the writers are complete.
    together.notes = tuple(dict.fromkeys(note for _, one in writers for note in one.notes))


def _list_rounding_notes(largest: float, diagonal: float) -> list[Said]:
    """Return a note if single precision rounds coordinates up to `largest` more than is usual."""
    rounding = float(np.spacing(np.float32(largest))) / 2
    if not diagonal or rounding <= MAX_ROUNDING * diagonal:
        return []
    return [
        f"coordinates of up to {largest:.3g} are rounded by up to {rounding:.2g}, "
        f"{100 * rounding / diagonal:.2g} % of the diagonal, as the format has single "
        "precision; "
        + say(
            "`recentre=True` of cageik export and deform moves them to the origin and "
            "writes the offset beside"
        )
    ]


def check_mesh_output(path: Path, overwrite: bool) -> None:
    """Refuse, before any work, a mesh file that cannot be written."""
    _choose_mesh_writer(path)
    check_writable(path, overwrite)


def write_mesh(
    path: Path, mesh: TriMesh, positions: Floats, overwrite: bool, *, is_exact: bool = False
) -> None:
    """Write a mesh at other positions, (m, 3), as a frame; to their last bit if `is_exact`."""
    animation = Animation(mesh, 1, Scene(start=0), path.stem)
    writer = _choose_mesh_writer(path)(path.with_name(f"_####{path.suffix.lower()}"), animation)
    data = writer.encode_exact(positions) if is_exact else writer.encode_frame(positions)
    write_bytes(path, data, overwrite)


def _choose_mesh_writer(path: Path) -> type[FrameFileWriter]:
    """Return the writer of files of one mesh for the path's suffix."""
    known = _find_writers().items()
    writers = {suffix: one for suffix, one in known if issubclass(one, FrameFileWriter)}
    if path.suffix.lower() not in writers:
        raise OutputError(
            f"{path}: `{path.suffix}` is not a mesh format that can be written, expected "
            f"{', '.join(writers)}"
        )
    return writers[path.suffix.lower()]


def names_parts(path: Path) -> bool:
    """Return whether the name of an output has a place for that of a part."""
    return PLACEHOLDER in str(path)


def split_output(output: Output, mesh: TriMesh, name: str) -> list[Output]:
    """Return the output of each part of a mesh; the output alone if its name has no `{part}`.

    A mesh that came as one has a `name`.

    Raises
    ------
    InputError
        When the parts have no files or folders of their own.
    """
    if not names_parts(output.path):
        return [output]
    names = name_part_files([part.name or name for part in split_parts(mesh)])
    typed = str(output.path)
    outputs = [
        replace(output, path=Path(typed.replace(PLACEHOLDER, each)), makes_folder=True)
        for each in names
    ]
    if len({each.target_path for each in outputs}) < len(outputs):
        raise OutputError(
            f"{output.path}: each part needs a folder of its own; put {PLACEHOLDER} into its name, "
            f"as in {_suggest_name(output)}"
        )
    if output.recentre and output.find_writer().is_in_part_space:
        raise SettingError(
            f"{output.path}: "
            + say(
                "positions of a part are in its own space, which `recentre=True` cannot "
                "move; leave one of them out"
            )
        )
    return outputs


def name_part_files(names: list[str]) -> list[str]:
    """Return a name for the file of each part: short, safe on all systems, and all different.

    None has a character that stands for the number of a frame.
    """
    short = (name.translate(NO_NUMBERS) for name in choose_short_names(names))
    return number_file_names(map(make_file_name, short))


class _PartsWriter(AnimationWriter):
    """Hands each part of the frames to its writer, which its output completes."""

    def __init__(self, writers: list[tuple[Part, AnimationWriter]]) -> None:
        self._writers = writers
        self.is_single = writers[0][1].is_single

    def append(self, frames: Floats) -> None:
        """Write the next frames of each part."""
        for part, writer in self._writers:
            own = part.select(frames) if writer.is_in_part_space else frames[:, part.vertices]
            writer.append(np.ascontiguousarray(own))


def _list_part_notes(outputs: list[Output], output: Output, animation: Animation) -> list[str]:
    """Return a note on how the parts of a model are written, unless the format knows parts."""
    parts, writer = split_parts(animation.rest), output.find_writer()
    if names_parts(output.path):
        names = join_truncated(each.path.name for each in outputs)
        return [f"a file of each part: {names}"] if len(outputs) > 1 else []
    if writer.keeps_parts:
        return []
    example = _suggest_name(output)
    if len(parts) > 1:
        names = join_truncated(choose_short_names([part.name for part in parts]))
        return [f"holds its {len(parts)} parts as one mesh: {names}; {example} writes one of each"]
    if writer.is_in_part_space and not np.array_equal(parts[0].transform, np.eye(4)):
        return [f"is in the space of the scene; {example} is in that of the mesh"]
    return []


def _suggest_name(output: Output) -> str:
    """Return a name with a place for that of a part."""
    path = output.path
    if output.frame_names is None:
        return str(path.with_name(f"{path.stem}_{PLACEHOLDER}{path.suffix}"))
    folder = output.target_path
    typed = folder.with_name(f"{folder.name}_{PLACEHOLDER}")
    return str(typed if output.is_folder else typed / path.name)
