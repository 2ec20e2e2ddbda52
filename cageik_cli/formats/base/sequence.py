"""A clip: frames of one connectivity, read on demand."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cageik_cli.formats.base.mesh_data import LoadedMesh, check_connectivity
from cageik_cli.formats.settings import ClipSettings, Scene, SceneHints
from cageik_cli.formats.timeline import Timeline
from cageik_cli.geometry.frames import Block
from cageik_cli.geometry.mesh import TriMesh, validate_known_positions, validate_positions
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import (
    ConnectivityError,
    FormatError,
    InputError,
    SettingError,
    error_context,
    join_truncated,
)
from cageik_cli.util.messages import Note, Said, say
from cageik_cli.util.text import group_digits
from cageik_cli.util.threads import OrderedMap


@dataclass(frozen=True, slots=True, eq=False)
class ClipRequest:
    """What a reader opens.

    Attributes
    ----------
    paths : tuple of Path
        In order, all of one suffix.
    member : str, optional
        Name of the clip in a file that holds several: the text behind `::`.
    rest : LoadedMesh, optional
        The rest pose, for files that hold no faces.
    """

    paths: tuple[Path, ...]
    member: str | None = None
    rest: LoadedMesh | None = None
    settings: ClipSettings = field(default_factory=ClipSettings)

    @property
    def path(self) -> Path:
        """The only path, for a format that holds a clip in one file."""
        if len(self.paths) > 1:
            raise SettingError(
                f"{self.paths[0]}: {len(self.paths)} files that each hold a clip, expected one: "
                f"{join_truncated(path.name for path in self.paths)}"
            )
        return self.paths[0]

    def complete_first(self, positions: np.ndarray) -> np.ndarray:
        """Return the vertices of the first frame, (m, 3), for the mesh of all frames' faces.

        Missing ones are at the mean of the others.
        """
        if not np.isnan(positions).any():
            return positions
        positions = _validate_frame(positions, self.settings.missing)
        is_missing = np.isnan(positions).any(axis=1)
        known = positions[~is_missing]
        positions[is_missing] = known.mean(axis=0) if len(known) else 0.0
        return positions

    def select_frames(self, count: int, scene: SceneHints) -> range:
        """Return the indices of the selected frames of `count`, whose numbers are of a scene."""
        timeline = scene.override(Scene()).make_timeline(count)
        return timeline.choose(self.settings.selection)


class MeshSequence(ABC):
    """Frames of one connectivity, in order; they can be read more than once.

    The `Reader` of each format subclasses this, see `formats.open`. Most subclass
    `FrameFileReader` (a mesh file per frame), `ArrayClipFile` or `ClipFile` (all frames in a file).

    Attributes
    ----------
    suffixes : tuple of str
        Lower case, with the dot.
    has_members : bool
        Whether a file may hold several clips, named by `FILE::CLIP`.
    has_parts : bool
        Whether a file may hold several meshes that are read as parts of one.
    has_layout : bool
        Whether a file may have its axes in any order, given by `ClipSettings.layout`.
    names : tuple of str
        Where each frame comes from, F of them: a file's name, or the clip's name and an index.
    first : TriMesh
        Frame 0 and the connectivity of all.
    scene : SceneHints
        Scene settings in the files, and the frame numbers in their names.
    missing : frozenset of int
        Frames that have no file, because gaps between the numbers of files are kept.
    notes : tuple of Note
        What was changed in the frames, one sentence each.
    takes_missing : bool
        Whether vertices that are not numbers are missing; otherwise their frames are refused.
    needs_rest : bool
        Whether the file holds no faces, which are those of the rest pose.

    Examples
    --------
    >>> from cageik_cli import load_clip
    >>> clip = load_clip("data_fixtures/walker/frames", selection=slice(0, 3))
    >>> len(clip), clip.names[2]
    (3, 'walker_3.obj')
    >>> [frame.shape for frame in clip]
    [(1570, 3), (1570, 3), (1570, 3)]
    """

    suffixes: tuple[str, ...]
    has_members: bool = False
    has_parts: bool = False
    has_layout: bool = False
    names: tuple[str, ...]
    first: TriMesh
    scene: SceneHints = SceneHints()
    missing: frozenset[int] = frozenset()
    notes: tuple[Note, ...] = ()
    takes_missing: bool = False
    needs_rest: bool = False

    @abstractmethod
    def __init__(self, request: ClipRequest) -> None:
        """Open the clip."""

    @classmethod
    def describe_contents(cls, request: ClipRequest) -> list[tuple[str, Said]]:
        """Describe files that are not a clip by themselves, in labelled lines; empty for a clip."""
        return []

    @classmethod
    def list_members(cls, path: Path) -> list[str]:
        """List the clips in a file that holds several; empty if it is a clip itself."""
        return []

    @abstractmethod
    def read_positions(self, index: int) -> np.ndarray:
        """Read the vertices of one frame as the file has them, in the connectivity of `first`."""

    @abstractmethod
    def digest(self, index: int) -> bytes:
        """Return the SHA-256 digest of the file that a frame comes from."""

    def digest_or_zeros(self, index: int) -> bytes:
        """Return the digest of a frame's file; zeros when it cannot be read: the frame is a gap."""
        try:
            return self.digest(index)
        except InputError:
            return bytes(hashlib.sha256().digest_size)

    def content_digest(self, index: int) -> bytes:
        """Return a digest of all that decides the vertices of a frame; zeros if it is unreadable.

        Unlike names of files, which may change, the content decides what can be used again.
        """
        return self.digest_or_zeros(index)

    @abstractmethod
    def set_digests(self, start: int, digests: Sequence[bytes]) -> None:
        """Take the digests of frames from `start` on, so that their files are not read for them."""

    @abstractmethod
    def describe_source(self) -> dict[str, Any]:
        """Return the name and digest of all that is read."""

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Floats]:
        """Read the frames one by one, (m, 3) each."""
        return map(self.read_frame, range(len(self)))

    def __repr__(self) -> str:
        return (
            f"<MeshSequence: {len(self)} frames of {len(self.first.vertices)} vertices, "
            f"{self.names[0]} to {self.names[-1]}>"
        )

    @property
    def timeline(self) -> Timeline:
        """The numbers of the frames."""
        return self.scene.override(Scene()).make_timeline(len(self))

    def location(self, index: int) -> str:
        """Return where a frame is, for messages."""
        return self.names[index]

    def read_frame(self, index: int) -> Floats:
        """Read the vertices of one frame, (m, 3): as many as the first has, and all finite.

        Missing ones are nan, if they may be missing.

        Raises
        ------
        InputError
            Naming the frame.
        """
        positions = self.read_positions(index)
        with error_context(self.location(index)):
            check_connectivity(len(positions), self.first.faces, self.first, "the rest pose")
            return _validate_frame(positions, self.takes_missing)

    def blocks(self, size: int, jobs: int) -> Generator[Block]:
        """Read all frames, in order, in blocks of `size`, ahead by threads.

        At most two blocks of frames are in memory.
        """
        with FramePrefetcher(self, jobs, size, range(len(self))) as frames:
            yield from frames.blocks(size)


class ArraySequence(MeshSequence):
    """Frames in an array (F, m, 3), as a clip in the connectivity of a rest pose of m vertices."""

    def __init__(self, frames: Floats, rest: TriMesh) -> None:
        self._frames, self.first = frames, rest
        self.names = tuple(f"frame {k}" for k in range(len(frames)))

    def read_positions(self, index: int) -> Floats:
        """Return the vertices of one frame."""
        return np.asarray(self._frames[index])

    def digest(self, index: int) -> bytes:
        """Return zeros: a frame comes from no file."""
        return bytes(hashlib.sha256().digest_size)

    def set_digests(self, start: int, digests: Sequence[bytes]) -> None:
        """Take nothing: there are no files."""

    def describe_source(self) -> dict[str, Any]:
        """Return a name, and a digest of all frames."""
        return {"name": "array", "sha256": hashlib.sha256(self._frames.tobytes()).hexdigest()}


def as_sequence(clip: MeshSequence | ArrayLike, rest: TriMesh) -> MeshSequence:
    """Return a clip of a rest pose, or an array (F, m, 3) of its frames as one."""
    if isinstance(clip, MeshSequence):
        sequence, found = clip, (len(clip), *clip.first.vertices.shape)
    else:
        try:
            frames = np.asarray(clip, np.float64)
        except (TypeError, ValueError) as error:
            raise ConnectivityError(
                f"frames are no array of numbers (F, {len(rest.vertices)}, 3): {error}"
            ) from error
        sequence, found = ArraySequence(frames, rest), frames.shape
    if found[1:] != rest.vertices.shape or not found[0]:
        raise ConnectivityError(
            f"frames have shape {found}, expected (F, {len(rest.vertices)}, 3) as the rest pose "
            f"has {group_digits(len(rest.vertices))} vertices; give frames of that mesh"
        )
    return sequence


def _validate_frame(positions: np.ndarray, takes_missing: bool) -> Floats:
    """Return positions (m, 3) that are finite, or missing if that is allowed."""
    if takes_missing:
        return validate_known_positions(positions)
    try:
        return validate_positions(positions)
    except FormatError as error:
        if np.isnan(positions).any() and not np.isinf(positions).any():
            raise FormatError(
                error.text + say(", or take them as missing with `missing=True` of cageik extract")
            ) from error
        raise


class FramePrefetcher:
    """Reads frames of a clip by `jobs` threads, at most `max_ahead` in advance."""

    def __init__(self, sequence: MeshSequence, jobs: int, max_ahead: int, indices: range) -> None:
        self._sequence, self._indices = sequence, indices
        self._frames = OrderedMap(self._read_or_error, indices, jobs, max_ahead)

    def __enter__(self) -> FramePrefetcher:
        return self

    def __exit__(self, *error: object) -> None:
        self._frames.__exit__()

    def blocks(self, size: int) -> Iterator[Block]:
        """Yield the frames in blocks of at most `size`."""
        for start in self._indices[::size]:
            read = list(islice(self._frames, size))
            errors = {k: v for k, v in enumerate(read, start) if isinstance(v, InputError)}
            placeholder = self._sequence.first.vertices
            positions = np.stack([placeholder if isinstance(v, InputError) else v for v in read])
            yield Block(start, positions, errors)

    def _read_or_error(self, index: int) -> Floats | InputError:
        try:
            return self._sequence.read_frame(index)
        except InputError as error:
            return error
