"""A folder of files, one a frame: what its writers have in common."""

from abc import abstractmethod
from pathlib import Path

from cageik_cli.export.animation import Animation, AnimationWriter
from cageik_cli.export.frame_names import FrameNames
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import InputError


class FrameFileWriter(AnimationWriter):
    """Writes a file a frame, numbered from the scene's start; writers say what a file holds."""

    into_folder = True

    def __init__(self, target: Path, animation: Animation) -> None:
        names = FrameNames.of(target.name)
        if names is None:
            raise ValueError(f"{target.name} has no place for the frame's number")
        start = animation.scene.start
        if start < 0 or start != int(start):
            raise InputError(
                f"the first frame's number is {start:g}, expected a whole one, 0 or above, for "
                "files are named by it; choose it with --start"
            )
        self._folder, self._names, self._next = target.parent, names, int(start)

    @abstractmethod
    def content(self, positions: Floats) -> bytes:
        """The file of one frame, (m, 3)."""

    def append(self, frames: Floats) -> None:
        """Write the next frames."""
        for positions in frames:
            (self._folder / self._names.name(self._next)).write_bytes(self.content(positions))
            self._next += 1

    def complete(self) -> None:
        """Nothing comes after the last frame."""
