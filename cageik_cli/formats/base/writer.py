"""What a writer is given, and what it does."""

from abc import ABC, abstractmethod
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.file_names import FrameNames
from cageik_cli.formats.scene import Scene
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import OutputError, SettingError


@dataclass(frozen=True, slots=True, eq=False)
class Animation:
    """What is known of an animation before its first frame.

    Attributes
    ----------
    rest : TriMesh
        The rest pose, with the faces of every frame.
    frame_count : int
        How many frames there are.
    scene : Scene
    name : str
        What the object is called where formats name objects: letters, digits and underscores.
    obj_text : bytes
        The OBJ file that the rest mesh was read from, unpacked; empty if it was none.
    """

    rest: TriMesh
    frame_count: int
    scene: Scene
    name: str
    obj_text: bytes = b""


class AnimationWriter(ABC):
    """Writes one animation: its frames are appended in order, then it is completed.

    A writer holds some blocks of frames at most, whatever their number. It takes any name for
    where it writes: the file, or the folder, gets its own when it is whole. The same animation
    gives the same bytes.

    Attributes
    ----------
    suffixes : tuple of str
        Lower case, with the dot.
    writes_folder : bool
        Whether it writes a folder of files, a frame each, instead of a file.
    notes : tuple of str
        What to mind about what is written, one sentence each.
    """

    suffixes: tuple[str, ...]
    writes_folder: bool = False
    notes: tuple[str, ...] = ()

    @classmethod  # noqa: B027  # most need no other library
    def require_libraries(cls) -> None:
        """Refuse to go on without a library that is needed, with what to install."""

    @abstractmethod
    def __init__(self, target: Path, animation: Animation) -> None:
        """Begin to write to `target`, whose suffix is one of `suffixes`.

        The name of a `target` in a folder of files is their pattern, see `FrameNames`.

        Raises
        ------
        InputError
            When the format cannot hold the animation, before anything is written.
        """

    @abstractmethod
    def append(self, frames: Floats) -> None:
        """Write the next k frames, (k, m, 3), in the units of the files they came from."""

    @abstractmethod
    def complete(self) -> None:
        """Write what comes after the last frame, and close the file."""

    def abandon(self) -> None:  # noqa: B027  # most have nothing to let go of
        """Close what is open, after a failure; what was written is thrown away."""


class FrameFileWriter(AnimationWriter):
    """Writes a file a frame, numbered from the scene's start; writers say what a file holds."""

    writes_folder = True

    def __init__(self, target: Path, animation: Animation) -> None:
        names = FrameNames.parse(target.name)
        if names is None:
            raise ValueError(f"{target.name} has no place for the frame's number")
        start = animation.scene.start
        if start < 0 or start != int(start):
            raise SettingError(
                f"the first frame's number is {start:g}, expected a whole one, 0 or above, for "
                "files are named by it; choose it with --start"
            )
        self._folder, self._names, self._next_number = target.parent, names, int(start)

    @abstractmethod
    def encode_frame(self, positions: Floats) -> bytes:
        """The file of one frame, (m, 3)."""

    def append(self, frames: Floats) -> None:
        """Write the next frames."""
        for positions in frames:
            (self._folder / self._names.file_name(self._next_number)).write_bytes(
                self.encode_frame(positions)
            )
            self._next_number += 1

    def complete(self) -> None:
        """Nothing comes after the last frame."""


def to_float32(positions: Floats) -> NDArray[np.float32]:
    """`positions` as contiguous float32.

    Raises
    ------
    InputError
        When one is too large for it.
    """
    with np.errstate(over="ignore"):
        singles = np.ascontiguousarray(positions, np.float32)
    if not np.isfinite(singles).all():
        raise OutputError(
            f"a coordinate of {np.abs(positions).max():g} is too large for this format, which "
            "holds numbers of single precision; scale the animation, or write .npz"
        )
    return singles


class PointCacheWriter(AnimationWriter):
    """Writes a header and float32 positions, frame by frame; writers say what the header is.

    Attributes
    ----------
    dtype : str
        Numpy's name of float32 in the file's byte order.
    """

    dtype: str

    def __init__(self, target: Path, animation: Animation) -> None:
        with ExitStack() as stack:
            self._file = stack.enter_context(target.open("wb"))
            self._file.write(self.make_header(animation))
            stack.pop_all()  # open from here on

    @abstractmethod
    def make_header(self, animation: Animation) -> bytes:
        """What stands before the first frame."""

    def append(self, frames: Floats) -> None:
        """Write the next frames."""
        self._file.write(to_float32(frames).astype(self.dtype, copy=False).data)

    def complete(self) -> None:
        """Close the file."""
        self._file.close()

    def abandon(self) -> None:
        """Close the file."""
        self._file.close()


def make_blender_notes(start: float) -> tuple[str, ...]:
    """Where Blender's Mesh Cache modifier puts the first frame, unless that is where it belongs."""
    if start == 0:
        return ()
    return (
        f"Blender's Mesh Cache puts the first frame at scene frame 0; set its Frame Start to "
        f"{start:g}",
    )
