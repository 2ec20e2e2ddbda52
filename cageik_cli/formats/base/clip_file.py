"""A clip that one file holds."""

import hashlib
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from cageik_cli.formats.base.sequence import ClipRequest, MeshSequence
from cageik_cli.formats.scene import SceneHints
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import InputError, first_few, located
from cageik_cli.util.text import printable


class ClipFile(MeshSequence):
    """Frames of one file, each named by its number in it; readers say what `positions` are.

    Attributes
    ----------
    path : Path
    numbers : range
        Which of the file's frames the clip's are; set by `take`.
    """

    path: Path
    numbers: range
    _fanned: TriMesh | None = None

    def take(self, request: ClipRequest, count: int, scene: SceneHints | None = None) -> None:
        """Take those of the file's `count` frames that are asked for, and name them.

        `scene` is what the file says of all of them.
        """
        self.path = only(request.paths)
        self.numbers = request.chosen(count)
        self.scene = (scene or SceneHints()).chosen(self.numbers)
        member = f"::{request.member}" if request.member is not None else ""
        name = printable(self.path.name + member)
        self.names = tuple(f"{name}[{k}]" for k in self.numbers)

    def take_faces(self, request: ClipRequest, vertices: int) -> None:
        """Take the rest pose's faces, for a file that holds positions alone, of `vertices`.

        Raises
        ------
        InputError
            When no rest pose is given, or it has not as many vertices.
        """
        rest = request.rest
        with located(self.path):
            if rest is None:
                raise InputError(
                    "holds positions and no faces; give a mesh that has them with --rest"
                )
            if vertices != len(rest.mesh.vertices):
                raise InputError(
                    f"{vertices} vertices, the rest pose has {len(rest.mesh.vertices)}; all must "
                    "share one connectivity"
                )
        positions = self.positions(0)
        with located(self.names[0]):
            self.first = TriMesh(positions, rest.mesh.faces)
        self._fanned = TriMesh(self.first.vertices, rest.fanned.faces)

    @property
    def fanned(self) -> TriMesh:
        """Frame 0 with every polygon as a fan: what connectivity is compared by."""
        return self._fanned or self.first

    def digest(self, index: int) -> bytes:
        """SHA-256 of the file."""
        return self._digest

    def recall(self, start: int, stamps: Sequence[bytes]) -> None:
        """Take the file's digest from who has it: that of any frame."""
        self._digest = stamps[0]

    def source(self) -> dict[str, Any]:
        """Name and digest of the file."""
        return {"name": printable(self.path.name), "sha256": self._digest.hex()}

    @cached_property
    def _digest(self) -> bytes:
        return digest_of(self.path)


def digest_of(path: Path) -> bytes:
    """SHA-256 of a file."""
    with located(path):
        try:
            with path.open("rb") as stream:
                return hashlib.file_digest(stream, "sha256").digest()
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror or error}") from error


def refuse_counted_from_one(faces: np.ndarray, vertices: int) -> None:
    """Refuse faces that name one vertex more than there are `vertices`, and never vertex 0.

    Raises
    ------
    InputError
    """
    if faces.size and faces.min() > 0 and faces.max() == vertices:
        raise InputError(
            f"faces name vertices {faces.min()} to {vertices} of {vertices}, so they are counted "
            "from 1; take 1 off them and write the file again"
        )


def only(paths: tuple[Path, ...]) -> Path:
    """The one file of a clip that is not a file a frame."""
    if len(paths) > 1:
        raise InputError(
            f"{paths[0]}: {len(paths)} files that each hold a clip were named, expected one: "
            f"{first_few(path.name for path in paths)}"
        )
    return paths[0]


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
