"""Blocks of frames through a writer."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cageik_cli.export.animation import Animation
from cageik_cli.export.opening import Maker, created, place_of, prepare_animation
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import located
from cageik_cli.util.progress import Observer
from cageik_cli.util.text import bytes_text


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
