"""What a writer is given, and what it does."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.scene import Scene
from cageik_cli.util.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Animation:
    """What is known of an animation before its first frame.

    Attributes
    ----------
    rest : TriMesh
        The rest pose, with the faces of every frame.
    count : int
        How many frames there are.
    scene : Scene
    name : str
        What the object is called where formats name objects: letters, digits and underscores.
    text : bytes
        The OBJ file that the rest mesh was read from, unpacked; empty if it was none.
    """

    rest: TriMesh
    count: int
    scene: Scene
    name: str
    text: bytes = b""


class AnimationWriter(ABC):
    """Writes one animation: its frames are appended in order, then it is completed.

    A writer holds some blocks of frames at most, whatever their number. It takes any name for
    where it writes: the file, or the folder, gets its own when it is whole. The same animation
    gives the same bytes.

    Attributes
    ----------
    suffixes : tuple of str
        Lower case, with the dot.
    into_folder : bool
        Whether it writes a folder of files, a frame each, instead of a file.
    notes : tuple of str
        What to mind about what is written, one sentence each.
    """

    suffixes: tuple[str, ...]
    into_folder: bool = False
    notes: tuple[str, ...] = ()

    @classmethod  # noqa: B027  # most need no other library
    def require(cls) -> None:
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
