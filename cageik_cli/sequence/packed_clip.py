"""A clip that lies as numbers in one file, with faces of its own or those of the rest pose."""

from abc import abstractmethod
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.scene import SceneHints
from cageik_cli.sequence.clip import ClipRequest
from cageik_cli.sequence.clip_file import ClipFile, only, refuse_counted_from_one
from cageik_cli.util.errors import located
from cageik_cli.util.text import printable


class Frames(Protocol):
    """Frames of a file: `count` of them, of `vertices` each."""

    count: int
    vertices: int

    def frame(self, index: int) -> np.ndarray:
        """Positions of one frame, (m, 3)."""


@dataclass(frozen=True, slots=True, eq=False)
class PackedClip:
    """What a file holds.

    Attributes
    ----------
    frames : Frames
    faces : (t, 3) integers, optional
        The rest pose's if absent.
    scene : SceneHints
        What the file says of all its frames.
    notes : tuple of str
        What is odd in it, a sentence each.
    """

    frames: Frames
    faces: np.ndarray | None = None
    scene: SceneHints = field(default_factory=SceneHints)
    notes: tuple[str, ...] = ()


class PackedClipFile(ClipFile):
    """Frames of such a file; readers say where in it they are."""

    def __init__(self, request: ClipRequest) -> None:
        self.path = only(request.paths)
        with located(self.path):
            packed = self.opened(request)
            self.take(request, packed.frames.count, packed.scene)
        self._frames = packed.frames
        self.notes = tuple(f"{printable(self.path.name)}: {note}" for note in packed.notes)
        if packed.faces is None:
            self.take_faces(request, packed.frames.vertices)
            return
        positions = self.positions(0)
        with located(self.path):
            refuse_counted_from_one(packed.faces, packed.frames.vertices)
            self.first = TriMesh(positions, packed.faces)

    @classmethod
    @abstractmethod
    def opened(cls, request: ClipRequest) -> PackedClip:
        """Look into the file, every claim of which is compared with its size.

        Raises
        ------
        InputError
            Without the file's name.
        """

    @classmethod
    def outline(cls, request: ClipRequest) -> list[tuple[str, str]]:
        """What a file without faces holds."""
        path = only(request.paths)
        with located(path):
            packed = cls.opened(request)
        if packed.faces is not None:
            return []
        return [
            ("holds", "positions without faces, which --rest gives"),
            ("frames", str(packed.frames.count)),
            ("vertices", str(packed.frames.vertices)),
            *([("scene", packed.scene.words)] if packed.scene.words else []),
            *(("note", note) for note in packed.notes),
        ]

    def positions(self, index: int) -> np.ndarray:
        """Vertices of one frame."""
        with located(self.path):
            return self._frames.frame(self.numbers[index])
