"""Clips of which one file holds all frames."""

import hashlib
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from cageik_cli.formats.base.file_data import hash_file
from cageik_cli.formats.base.sequence import ClipRequest, MeshSequence
from cageik_cli.formats.scene import SceneHints
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import (
    ConnectivityError,
    FormatError,
    SettingError,
    error_context,
    join_truncated,
)
from cageik_cli.util.text import to_unicode


class ClipFile(MeshSequence):
    """Frames of one file, each named by its number in it; formats implement `read_positions`.

    Attributes
    ----------
    frame_indices : range
        Which of the file's frames the clip's are; set by `set_frames`.
    """

    path: Path
    frame_indices: range
    _reading: tuple[str | None, str | None] = (None, None)

    def set_frames(self, request: ClipRequest, count: int, scene: SceneHints | None = None) -> None:
        """Select the requested frames of the `count` in the file, and name them.

        `scene` has the settings that the file gives for all of them.
        """
        self.path = single_path(request.paths)
        self.frame_indices = request.select_frames(count)
        self._reading = (request.member, request.settings.layout)
        self.scene = (scene or SceneHints()).restrict_to_frames(self.frame_indices)
        member = f"::{request.member}" if request.member is not None else ""
        name = to_unicode(self.path.name + member)
        self.names = tuple(f"{name}[{k}]" for k in self.frame_indices)

    def use_rest_faces(self, request: ClipRequest, vertex_count: int) -> None:
        """Take the faces of the rest pose, for a file of `vertex_count` vertices and no faces.

        Raises
        ------
        InputError
            When no rest pose is given, or it has another number of vertices.
        """
        rest = request.rest
        with error_context(self.path):
            if rest is None:
                raise SettingError(
                    "holds positions but no faces; give a mesh with the faces by --rest"
                )
            if vertex_count != len(rest.mesh.vertices):
                raise ConnectivityError(
                    f"{vertex_count} vertices, the rest pose has {len(rest.mesh.vertices)}; all "
                    "must share one connectivity"
                )
        positions = self.read_positions(0)
        with error_context(self.names[0]):
            self.first = rest.mesh.move(request.complete_first(positions))

    def digest(self, index: int) -> bytes:
        """Return the SHA-256 digest of the file."""
        return self._digest

    def content_digest(self, index: int) -> bytes:
        """Return a digest of the file, and of where and how the frame is read from it."""
        place = f"{self.frame_indices[index]} {self._reading}".encode()
        return hashlib.sha256(self.digest_or_zeros(index) + place).digest()

    def set_digests(self, start: int, digests: Sequence[bytes]) -> None:
        """Take the digest of the file: that of any frame."""
        self._digest = digests[0]

    def describe_source(self) -> dict[str, Any]:
        """Return the name and digest of the file."""
        return {"name": to_unicode(self.path.name), "sha256": self._digest.hex()}

    @cached_property
    def _digest(self) -> bytes:
        return hash_file(self.path)


def check_zero_based(faces: np.ndarray, vertex_count: int) -> None:
    """Refuse faces that count vertices from 1: they name `vertex_count` and never 0.

    Raises
    ------
    FormatError
    """
    if faces.size and faces.min() > 0 and faces.max() == vertex_count:
        raise FormatError(
            f"faces name vertices {faces.min()} to {vertex_count} of {vertex_count}, so "
            "they count from 1; subtract 1 and write the file again"
        )


def single_path(paths: tuple[Path, ...]) -> Path:
    """Return the only path, for a format that holds a clip in one file."""
    if len(paths) > 1:
        raise SettingError(
            f"{paths[0]}: {len(paths)} files that each hold a clip, expected one: "
            f"{join_truncated(path.name for path in paths)}"
        )
    return paths[0]


class FrameSource(Protocol):
    """Frames in a file: `frame_count` of them, with `vertex_count` vertices each."""

    frame_count: int
    vertex_count: int

    def read_frame(self, index: int) -> np.ndarray:
        """Read the positions of one frame, (m, 3)."""


@dataclass(frozen=True, slots=True, eq=False)
class ArrayClip:
    """The content of a file that holds a clip.

    Attributes
    ----------
    faces : (t, 3) integers, optional
        The rest pose's if absent.
    scene : SceneHints
        Scene settings that the file gives for all its frames.
    notes : tuple of str
        What is unusual in it, one sentence each.
    """

    frames: FrameSource
    faces: np.ndarray | None = None
    scene: SceneHints = field(default_factory=SceneHints)
    notes: tuple[str, ...] = ()


class ArrayClipFile(ClipFile):
    """Frames of such a file; formats implement `open_clip`."""

    def __init__(self, request: ClipRequest) -> None:
        self.path = single_path(request.paths)
        with error_context(self.path):
            clip = self.open_clip(request)
            self.set_frames(request, clip.frames.frame_count, clip.scene)
        self._frames = clip.frames
        self.notes = tuple(f"{to_unicode(self.path.name)}: {note}" for note in clip.notes)
        if clip.faces is None:
            self.use_rest_faces(request, clip.frames.vertex_count)
            return
        positions = self.read_positions(0)
        with error_context(self.path):
            check_zero_based(clip.faces, clip.frames.vertex_count)
            self.first = TriMesh(request.complete_first(positions), clip.faces)

    @classmethod
    @abstractmethod
    def open_clip(cls, request: ClipRequest) -> ArrayClip:
        """Open the file, and check what its header announces against its size.

        Raises
        ------
        InputError
            Without the file's name.
        """

    @classmethod
    def describe_contents(cls, request: ClipRequest) -> list[tuple[str, str]]:
        """Describe a file that has no faces."""
        path = single_path(request.paths)
        with error_context(path):
            clip = cls.open_clip(request)
        if clip.faces is not None:
            return []
        return [
            ("holds", "positions without faces; give these by --rest"),
            ("frames", str(clip.frames.frame_count)),
            ("vertices", str(clip.frames.vertex_count)),
            *([("scene", clip.scene.description)] if clip.scene.description else []),
            *(("note", note) for note in clip.notes),
        ]

    def read_positions(self, index: int) -> np.ndarray:
        """Read the vertices of one frame."""
        with error_context(self.path):
            return self._frames.read_frame(self.frame_indices[index])
