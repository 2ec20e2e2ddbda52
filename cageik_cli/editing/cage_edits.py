"""Cage edits: offsets of cage vertices, from a file of their own; and the files of an edit."""

import hashlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.editing.handles.model import Handles, Motion
from cageik_cli.editing.handles.placement import check_keyframes, find_full_strength
from cageik_cli.editing.handles.reader import (
    MAX_HANDLES_BYTES,
    check_printable,
    check_schema,
    check_unique_names,
    describe_location,
    parse_frames,
    parse_motion,
    read_handles,
)
from cageik_cli.editing.handles.schedule import blend_frames
from cageik_cli.formats.timeline import Timeline, format_frame_number
from cageik_cli.geometry.mesh import MAX_COORDINATE, TriMesh
from cageik_cli.geometry.mirror import Mirror
from cageik_cli.geometry.shape import uniform_laplacian
from cageik_cli.method.pose.constraints import mirror_pairs
from cageik_cli.method.pose.rigidity import Cells, Neighbours
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import HandlesError, error_context
from cageik_cli.util.files import read_input
from cageik_cli.util.json_files import JsonFormat, parse_json
from cageik_cli.util.text import to_unicode

CAGE_EDITS_FORMAT = JsonFormat("a cage edits file", MAX_HANDLES_BYTES, describe_location)
"""What the JSON of a cage edits file should be."""


@dataclass(frozen=True, slots=True, eq=False)
class CageEdit:
    """Cage vertices that move together.

    Attributes
    ----------
    name : str
        Unique in its file.
    moves : tuple of (int, Motion)
        Each cage vertex once, with its offset; one at least.
    frames : (first, last), optional
        Numbers of the frames of full strength, both included; None for all frames.
    falloff : int
        The edit fades over numbers that are this far before and after those.
    turns : bool
        Whether the offsets turn with the cage around each vertex, from the rest cage.
    """

    name: str
    moves: tuple[tuple[int, Motion], ...]
    frames: tuple[float, float] | None = None
    falloff: int = 0
    turns: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class CageEdits:
    """The content of a cage edits file; `data` is all of the file."""

    path: Path
    data: bytes
    edits: tuple[CageEdit, ...]


def read_cage_edits(path: Path) -> CageEdits:
    """Read a cage edits file.

    Raises
    ------
    FileAccessError, FormatError
        When the file cannot be read as JSON.
    HandlesError
        When its content is wrong; the message names the file, the edit and the field.
    """
    with error_context(path):
        data = read_input(path, CAGE_EDITS_FORMAT.max_bytes, CAGE_EDITS_FORMAT.name, is_json=True)
        return parse_cage_edits(path, data)


def parse_cage_edits(path: Path, data: bytes) -> CageEdits:
    """Return the cage edits of a file that was read; messages do not name the file."""
    document = parse_json(data, CAGE_EDITS_FORMAT)
    check_schema(document, "cage_edits")
    edits = tuple(map(_parse_edit, document["edits"]))
    check_unique_names("edits", (edit.name for edit in edits))
    return CageEdits(path, data, edits)


def _parse_edit(raw: dict[str, Any]) -> CageEdit:
    moves: dict[int, Motion] = {}
    with error_context(f"edit {raw['name']!r}"):
        check_printable(raw["name"])
        for move in raw["moves"]:
            vertex = int(move["vertex"])
            with error_context(f"vertex {vertex}"):
                if vertex in moves:
                    raise HandlesError("is moved twice; keep one of the moves")
                moves[vertex] = parse_motion("offset", move["offset"])
        frames, falloff = parse_frames(raw), int(raw.get("falloff", 0))
    turns = raw.get("axes") == "surface"
    return CageEdit(raw["name"], tuple(moves.items()), frames, falloff, turns)


class MirrorImage:
    """The mirror images of moves of cage vertices, about a plane that turns with each frame.

    `rotations`, (F, 3, 3), are those of the rest pose to each frame; None for a single pose.
    """

    def __init__(self, mirror: Mirror, cage: TriMesh, rotations: Floats | None) -> None:
        self._normal, self._rotations = mirror.normal, rotations
        self.partners = mirror_pairs(cage, mirror)

    def reflect(self, moves: Floats, frames: Integers, is_at_rest: bool) -> Floats:
        """Return the mirror images of moves, (k, p, 3), in frames (k,), or all at rest."""
        normals = np.broadcast_to(self._normal, (len(frames), 3))
        if self._rotations is not None and not is_at_rest:
            normals = self._normal @ self._rotations[frames]
        heights = (moves * normals[:, None]).sum(axis=2, keepdims=True)
        return np.asarray(moves - 2 * heights * normals[:, None])


class CageEditLayer:
    """A cage edit, ready to be applied to the frames of a clip or to a single pose.

    Parameters
    ----------
    cage : TriMesh
        The rest cage.
    timeline : Timeline, optional
        The numbers of the frames of the clip; None for a single pose.
    image : MirrorImage, optional
        Partners of its vertices move as their mirror images, unless it moves them itself; vertices
        that are their own partners stay on the plane.

    Attributes
    ----------
    name : str
    vertices : (p,) int64
        Cage vertices that it moves.

    Raises
    ------
    HandlesError
        When the cage has no such vertex, or the clip no such frame; the message names them.
    """

    def __init__(
        self,
        edit: CageEdit,
        cage: TriMesh,
        timeline: Timeline | None,
        image: MirrorImage | None = None,
    ) -> None:
        self.name, count = edit.name, len(cage.vertices)
        self._cage, self._turns = cage, edit.turns
        self.vertices = np.array([vertex for vertex, _ in edit.moves], np.int64)
        self._motions = [motion for _, motion in edit.moves]
        self._timeline = timeline or Timeline(1, 0)
        with error_context(f"edit {edit.name!r}"):
            self._full_strength = find_full_strength(edit.frames, timeline)
            for vertex, motion in edit.moves:
                with error_context(f"vertex {vertex}"):
                    if vertex >= count:
                        raise HandlesError(
                            f"there is no such cage vertex; the cage has {count}, numbered from 0 "
                            f"to {count - 1}"
                        )
                    check_keyframes(motion, timeline)
        self._falloff = edit.falloff / (timeline.step if timeline else 1)
        self._image = image
        if image is not None:
            partners = image.partners[self.vertices]
            self._is_on_plane = partners == self.vertices
            self._is_copied = ~np.isin(partners, self.vertices)
            self.vertices = np.concatenate([self.vertices, partners[self._is_copied]])

    @cached_property
    def _cells(self) -> Cells:
        return Cells(Neighbours(uniform_laplacian(self._cage)), self._cage.vertices)

    def displacements(self, frames: Integers) -> Floats:
        """Return the displacements of its vertices in frames (k,), as (k, p, 3).

        Those that turn with the cage are as at rest.
        """
        strength = blend_frames(frames, self._full_strength, self._falloff)
        numbers = self._timeline.numbers(frames)
        offsets = [motion.evaluate(numbers) for motion in self._motions]
        moves = strength[:, None, None] * np.stack(offsets, axis=1)
        if self._image is None:
            return np.asarray(moves)
        images = self._image.reflect(moves, frames, is_at_rest=self._turns)
        on_plane = self._is_on_plane[:, None]
        moves = np.where(on_plane, (moves + images) / 2, moves)
        return np.concatenate([moves, images[:, self._is_copied]], axis=1)

    def apply(self, frames: Integers, cages: Floats) -> Floats:
        """Return the edited cages, (k, n, 3), of frames (k,).

        A vertex that does not move in a frame keeps its position there bit for bit.
        """
        moves, edited = self.displacements(frames), cages.copy()
        if self._turns:
            for k in np.flatnonzero(moves.any(axis=(1, 2))):
                turns = self._cells.fit_rotations(cages[k] - self._cage.vertices)
                moves[k] = np.einsum("ijp,pj->pi", turns[..., self.vertices], moves[k])
        before = cages[:, self.vertices]
        edited[:, self.vertices] = np.where(moves == 0, before, before + moves)
        is_far = np.abs(edited[:, self.vertices]) > MAX_COORDINATE
        if is_far.any():
            k, move, _ = np.argwhere(is_far)[0]
            number = format_frame_number(self._timeline.numbers(frames)[k])
            raise HandlesError(
                f"edit {self.name!r}: vertex {self.vertices[move]}: frame {number}: is moved too "
                f"far away (at most {MAX_COORDINATE:g}); choose a smaller offset"
            )
        return edited


@dataclass(frozen=True, slots=True, eq=False)
class EditFiles:
    """The files of an edit, one at least: its cage edits, and the handles that act after them."""

    handles: Handles | None = None
    cage_edits: CageEdits | None = None

    @classmethod
    def read(cls, handles: Path | None, cage_edits: Path | None) -> "EditFiles":
        """Read the files that are named."""
        return cls(
            None if handles is None else read_handles(handles),
            None if cage_edits is None else read_cage_edits(cage_edits),
        )

    @property
    def sources(self) -> dict[str, dict[str, str]]:
        """The name and the digest of each file, in hexadecimal digits, by what it is."""
        named = {"handles": self.handles, "cage_edits": self.cage_edits}
        return {
            role: {
                "name": to_unicode(file.path.name),
                "sha256": hashlib.sha256(file.data).hexdigest(),
            }
            for role, file in named.items()
            if file is not None
        }
