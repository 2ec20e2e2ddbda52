"""A clip: frames of one connectivity, read when they are asked for."""

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.base.settings import LAYOUTS as LAYOUTS
from cageik_cli.formats.base.settings import ClipSettings as ClipSettings
from cageik_cli.formats.scene import SceneHints
from cageik_cli.geometry.mesh import TriMesh, validate_positions
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import ConnectivityError, InputError, SettingError, error_context
from cageik_cli.util.threads import OrderedMap


@dataclass(frozen=True, slots=True, eq=False)
class ClipRequest:
    """What a reader is asked to open.

    Attributes
    ----------
    paths : tuple of Path
        In order, all of one suffix.
    member : str, optional
        Which of the clips in a file: what was typed behind `::`.
    rest : LoadedMesh, optional
        The rest pose, for files that hold no faces.
    settings : ClipSettings
    """

    paths: tuple[Path, ...]
    member: str | None = None
    rest: LoadedMesh | None = None
    settings: ClipSettings = field(default_factory=ClipSettings)

    def select_frames(self, count: int) -> range:
        """Numbers of the frames to take of `count`.

        Raises
        ------
        InputError
            When there are none.
        """
        wanted = self.settings.selection
        numbers = range(count)[wanted]
        if not numbers:
            bounds = (wanted.start, wanted.stop, *([wanted.step] if wanted.step else []))
            typed = ":".join("" if bound is None else str(bound) for bound in bounds)
            raise SettingError(f"--frames {typed} takes none of the {count} frames")
        return numbers


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Consecutive frames of a clip.

    Attributes
    ----------
    start : int
        Number of the first.
    positions : (k, m, 3) float64
        A frame that could not be read has the clip's first in its place, so that what is computed
        of the others does not depend on it.
    read_errors : dict
        By number in the clip, why a frame could not be read.
    """

    start: int
    positions: Floats
    read_errors: dict[int, InputError]

    @property
    def stop(self) -> int:
        """Number of the frame after the last."""
        return self.start + len(self.positions)

    def raise_read_errors(self) -> None:
        """Raise the first fault, if there is one."""
        if self.read_errors:
            raise self.read_errors[min(self.read_errors)]


class MeshSequence(ABC):
    """Frames of one connectivity, in order; they can be gone through more than once.

    A reader subclasses this and says which file suffixes it takes. Readers are the modules of
    `sequence.readers`; a new format is one file there.

    Attributes
    ----------
    suffixes : tuple of str
        Lower case, with the dot.
    has_members : bool
        Whether a file may hold several clips, named by `FILE::CLIP`.
    has_layout : bool
        Whether a file may have its axes in any order, said by `--layout`.
    names : tuple of str
        Where each frame comes from, F of them: a file's name, or the clip's name and an index.
    first : TriMesh
        Frame 0 and the connectivity of all.
    scene : SceneHints
        What the files say of time and space.
    notes : tuple of str
        What was changed in the frames, one sentence each.

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
    has_layout: bool = False
    names: tuple[str, ...]
    first: TriMesh
    scene: SceneHints = SceneHints()
    notes: tuple[str, ...] = ()

    @abstractmethod
    def __init__(self, request: ClipRequest) -> None:
        """Open the clip."""

    @classmethod
    def describe_contents(cls, request: ClipRequest) -> list[tuple[str, str]]:
        """What files hold that are no clip by themselves, in labelled lines; none for a clip."""
        return []

    @classmethod
    def list_members(cls, path: Path) -> list[str]:
        """Names of the clips in a file of several; none if the file is a clip itself."""
        return []

    @abstractmethod
    def read_positions(self, index: int) -> np.ndarray:
        """Vertices of one frame as the file has them, in the connectivity of `first`."""

    @abstractmethod
    def digest(self, index: int) -> bytes:
        """SHA-256 of the file that a frame comes from."""

    def digest_or_zeros(self, index: int) -> bytes:
        """The digest of a frame's file; zeros when it cannot be read, and the frame is a gap."""
        try:
            return self.digest(index)
        except InputError:
            return bytes(hashlib.sha256().digest_size)

    @abstractmethod
    def set_digests(self, start: int, digests: Sequence[bytes]) -> None:
        """Take the stamps of frames from `start` on from who has read them: not to read again."""

    @abstractmethod
    def describe_source(self) -> dict[str, Any]:
        """Name and digest of all that is read."""

    @property
    def fan_triangulated(self) -> TriMesh:
        """Frame 0 with every polygon as a fan: what connectivity is compared by."""
        return self.first

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

    def location(self, index: int) -> str:
        """Where a frame is, for messages."""
        return self.names[index]

    def read_frame(self, index: int) -> Floats:
        """Vertices of one frame, (m, 3), as many as the first has and all finite.

        Raises
        ------
        InputError
            Naming the frame.
        """
        positions = self.read_positions(index)
        with error_context(self.location(index)):
            check_connectivity(len(positions), self.first.faces, self.first, "the rest pose")
            return validate_positions(positions)

    def blocks(self, size: int, jobs: int, start: int = 0) -> Generator[Block]:
        """All frames from `start` on, in order, at most `size` in a block, read ahead by threads.

        At most two blocks of frames are in memory.
        """
        with FramePrefetcher(self, jobs, size, range(start, len(self))) as frames:
            yield from frames.blocks(size)


class FramePrefetcher:
    """Frames of a clip, `wanted` of them, read by `jobs` threads, at most `ahead` in advance."""

    def __init__(self, sequence: MeshSequence, jobs: int, max_ahead: int, indices: range) -> None:
        self._sequence, self._indices = sequence, indices
        self._frames = OrderedMap(self._read_or_error, indices, jobs, max_ahead)

    def __enter__(self) -> "FramePrefetcher":
        return self

    def __exit__(self, *error: object) -> None:
        self._frames.__exit__()

    def blocks(self, size: int) -> Iterator[Block]:
        """Them in blocks of at most `size`."""
        for start in self._indices[::size]:
            yield self._make_block(start, list(islice(self._frames, size)))

    def _read_or_error(self, index: int) -> Floats | InputError:
        try:
            return self._sequence.read_frame(index)
        except InputError as error:
            return error

    def _make_block(self, start: int, read: list[Floats | InputError]) -> Block:
        faults = {k: v for k, v in enumerate(read, start) if isinstance(v, InputError)}
        placeholder = self._sequence.first.vertices
        positions = np.stack([placeholder if isinstance(v, InputError) else v for v in read])
        return Block(start, positions, faults)


def check_connectivity(count: int, faces: Integers, expected: TriMesh, expected_name: str) -> None:
    """Refuse a mesh whose counts or `faces` differ from the expected ones, and say where.

    Raises
    ------
    InputError
    """
    for noun, found, wanted in (
        ("vertices", count, len(expected.vertices)),
        ("triangles", len(faces), len(expected.faces)),
    ):
        if found != wanted:
            raise ConnectivityError(
                f"{found} {noun}, {expected_name} has {wanted}; all must share one connectivity"
            )
    if faces is expected.faces:
        return
    differs = np.flatnonzero((faces != expected.faces).any(axis=1))
    if len(differs):
        k = differs[0]
        raise ConnectivityError(
            f"triangle {k} joins vertices {_format_corners(faces[k])}, in {expected_name} "
            f"{_format_corners(expected.faces[k])} (counted from 0; {len(differs)} triangles "
            f"differ); "
            "all must share one connectivity"
        )


def _format_corners(corners: Integers) -> str:
    return "-".join(map(str, corners))
