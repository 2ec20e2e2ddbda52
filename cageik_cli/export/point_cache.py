"""Positions behind a header, for a mesh that is elsewhere: what MDD and PC2 have in common."""

from abc import abstractmethod
from contextlib import ExitStack
from pathlib import Path

from cageik_cli.export.animation import Animation, AnimationWriter
from cageik_cli.export.single_precision import single_precision
from cageik_cli.util.arrays import Floats


class PointCacheWriter(AnimationWriter):
    """Writes a header and float32 positions, frame by frame; writers say what the header is.

    Attributes
    ----------
    kind : str
        Numpy's name of float32 in the file's byte order.
    """

    kind: str

    def __init__(self, target: Path, animation: Animation) -> None:
        with ExitStack() as stack:
            self._file = stack.enter_context(target.open("wb"))
            self._file.write(self.header(animation))
            stack.pop_all()  # open from here on

    @abstractmethod
    def header(self, animation: Animation) -> bytes:
        """What stands before the first frame."""

    def append(self, frames: Floats) -> None:
        """Write the next frames."""
        self._file.write(single_precision(frames).astype(self.kind, copy=False).data)

    def complete(self) -> None:
        """Close the file."""
        self._file.close()

    def abandon(self) -> None:
        """Close the file."""
        self._file.close()


def blender_note(start: float) -> tuple[str, ...]:
    """Where Blender's Mesh Cache modifier puts the first frame, unless that is where it belongs."""
    if start == 0:
        return ()
    return (
        f"Blender's Mesh Cache puts the first frame at scene frame 0; set its Frame Start to "
        f"{start:g}",
    )
