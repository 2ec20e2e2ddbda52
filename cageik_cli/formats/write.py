"""From the name of an output to its writer."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path

from cageik_cli.formats.base.file_names import FrameNames
from cageik_cli.formats.base.registry import by_suffix
from cageik_cli.formats.base.writer import Animation, AnimationWriter
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import InputError, located
from cageik_cli.util.outputs import prepare, prepare_folder, whole_folder, whole_path
from cageik_cli.util.progress import Observer
from cageik_cli.util.text import bytes_text

USUAL_KIND = "obj"
"""Of the files of a folder, where nobody says."""

USUAL_DIGITS = 4
"""Of the numbers of files in a folder that is but named."""

Maker = Callable[[Path, Animation], AnimationWriter]


def prepare_animation(path: Path, overwrite: bool, kind: str | None = None) -> None:
    """Refuse, before any work, an output of no known kind, that exists or cannot be written.

    Parameters
    ----------
    path : Path
        A file; the files of a folder by a pattern, see `FrameNames`; or a folder alone, whose
        files get its name and a number.
    overwrite : bool
        Whether what is there may be replaced: a file, or a folder of nothing but such files.
    kind : str, optional
        Of the files of a folder that is but named: their suffix without the dot.

    Raises
    ------
    InputError
        Naming the output and what to do.
    """
    target = _target_of(path, kind)
    with located(path):
        target.writer.require()
    if target.names is None:
        prepare(path, overwrite)
    else:
        prepare_folder(target.place, overwrite, target.names.has)


def place_of(path: Path, kind: str | None = None) -> Path:
    """The file or the folder that is written for the output `path`."""
    return _target_of(path, kind).place


@contextmanager
def created(
    path: Path,
    animation: Animation,
    overwrite: bool,
    kind: str | None = None,
    make: Maker | None = None,
) -> Iterator[AnimationWriter]:
    """A writer of the kind of `path`, which gets its name when the block ends without an error.

    Parameters
    ----------
    path, overwrite, kind
        As of `prepare_animation`.
    animation : Animation
    make : callable, optional
        Makes the writer, if it is not to be the usual one of that suffix.

    Raises
    ------
    InputError
        When it cannot be written, or cannot hold the animation.
    """
    target = _target_of(path, kind)
    with target.whole(overwrite) as name:
        with located(path):
            writer = (make or target.writer)(name, animation)
        try:
            yield writer
            writer.complete()
        except BaseException:
            writer.abandon()
            raise


@dataclass(frozen=True, slots=True)
class _Target:
    """What an output's name means.

    Attributes
    ----------
    place : Path
        The file or the folder that is written.
    writer : type of AnimationWriter
    names : FrameNames, optional
        Of the files in a folder.
    """

    place: Path
    writer: type[AnimationWriter]
    names: FrameNames | None

    def whole(self, overwrite: bool) -> AbstractContextManager[Path]:
        """The name to give the writer; what it writes takes the output's own when whole."""
        if self.names is None:
            return whole_path(self.place, overwrite)
        return self._whole_files(self.names, overwrite)

    @contextmanager
    def _whole_files(self, names: FrameNames, overwrite: bool) -> Iterator[Path]:
        with whole_folder(self.place, overwrite, names.has) as folder:
            yield folder / names.pattern


def _target_of(path: Path, kind: str | None) -> _Target:
    with located(path):
        names, place = FrameNames.of(path.name), path.parent
        suffix = path.suffix.lower()
        kinds = _writers()
        if names is None and suffix not in kinds and (kind or not suffix):
            suffix = f".{kind or USUAL_KIND}"
            names, place = FrameNames(f"{path.name}_", USUAL_DIGITS, suffix), path
        if suffix not in kinds:
            raise InputError(
                f"`{path.suffix}` is not a kind of animation written here, expected "
                f"{', '.join(kinds)}"
            )
        writer = kinds[suffix]
        if kind and suffix != f".{kind}":
            raise InputError(f"has the suffix of another format than {kind}; leave --format out")
        if writer.into_folder and names is None:
            raise InputError(
                f"a `{suffix}` file holds one frame; name a folder of them, "
                f"such as {path.stem}/{path.stem}_####{suffix}"
            )
        if names is not None and not writer.into_folder:
            raise InputError(f"a `{suffix}` file holds all frames; leave the frame's number out")
    return _Target(path if names is None else place, writer, names)


def _writers() -> dict[str, type[AnimationWriter]]:
    """The writers by the suffixes they take."""
    return by_suffix("Writer")


@dataclass(frozen=True, slots=True)
class Output:
    """Where an animation goes.

    Attributes
    ----------
    path : Path
    kind : str, optional
    overwrite : bool
        As `prepare_animation` has them.
    """

    path: Path
    kind: str | None = None
    overwrite: bool = False

    @property
    def place(self) -> Path:
        """The file or the folder that is written."""
        return place_of(self.path, self.kind)

    def prepare(self) -> None:
        """Refuse, before any work, what cannot be written; see `prepare_animation`."""
        prepare_animation(self.path, self.overwrite, self.kind)


@dataclass(frozen=True, slots=True)
class Written:
    """What was written.

    Attributes
    ----------
    path : Path
        As the user named it.
    frames, vertices : int
    size : int
        Bytes, of all files.
    """

    path: Path
    frames: int
    vertices: int
    size: int

    @property
    def line(self) -> str:
        """What to tell the user."""
        counts = f"{self.frames} frames of {self.vertices} vertices"
        return f"wrote {self.path}: {counts}, {bytes_text(self.size)}"


def write_animation(
    output: Output,
    animation: Animation,
    blocks: Iterator[Floats],
    watch: Observer,
    make: Maker | None = None,
) -> Written:
    """Write all `blocks` of frames, (k, m, 3), one after the other; what to mind is remarked.

    Raises
    ------
    InputError
        When it cannot be written, or cannot hold the animation.
    """
    path, done = output.path, 0
    with created(path, animation, output.overwrite, output.kind, make) as writer:
        while True:
            with watch.stage("export"):
                block = next(blocks, None)
                if block is None:
                    break
                with located(path):
                    writer.append(block)
            done += len(block)
            watch.advance(done, animation.count)
    for note in writer.notes:
        watch.remark("note", f"{path.name}: {note}")
    return Written(path, done, len(animation.rest.vertices), _size(output.place))


def _size(place: Path) -> int:
    files = place.iterdir() if place.is_dir() else [place]
    return sum(file.stat().st_size for file in files)
