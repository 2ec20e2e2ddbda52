"""A clip: frames of one connectivity, read when they are asked for."""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.errors import InputError, first_few, located
from cageik_cli.mesh import Floats, Integers, TriMesh, checked_positions


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Consecutive frames of a clip.

    Attributes
    ----------
    names : tuple of str
        k names.
    vertices : (k, m, 3) float64
    """

    names: tuple[str, ...]
    vertices: Floats


class MeshSequence(ABC):
    """Frames of one connectivity, in order; they can be gone through more than once.

    A reader subclasses this and says which file suffixes it takes. Readers are the modules of
    `sequence.readers`; a new format is one file there.

    Attributes
    ----------
    suffixes : tuple of str
        Lower case, with the dot.
    names : tuple of str
        Where each frame comes from, F of them: a file's name, or the clip's name and an index.
    first : TriMesh
        Frame 0 and the connectivity of all.
    """

    suffixes: tuple[str, ...]
    names: tuple[str, ...]
    first: TriMesh

    @classmethod
    @abstractmethod
    def open(cls, paths: list[Path], allow_gaps: bool) -> "MeshSequence":
        """Open the clip that `paths`, in order, all of one suffix, hold."""

    @abstractmethod
    def positions(self, index: int) -> Floats:
        """Vertices of one frame as the file has them, in the connectivity of `first`, checked."""

    @abstractmethod
    def source(self) -> dict[str, Any]:
        """Name and digest of what was read; complete once every frame was."""

    def __len__(self) -> int:
        return len(self.names)

    def place(self, index: int) -> str:
        """Where a frame is, for messages."""
        return self.names[index]

    def frame(self, index: int) -> Floats:
        """Vertices of one frame, (m, 3), as many as the rest pose has and all finite.

        Raises
        ------
        InputError
            Naming the frame.
        """
        positions = self.positions(index)
        expected = self.first.vertices.shape
        with located(self.place(index)):
            if positions.shape != expected:
                raise InputError(
                    f"{len(positions)} vertices, the rest pose has {expected[0]}; "
                    "frames must share one connectivity"
                )
            return checked_positions(positions)

    def blocks(self, size: int, jobs: int) -> Iterator[Block]:
        """All frames in order, at most `size` in a block, read ahead by `jobs` threads.

        At most two blocks of frames are in memory.
        """
        with ThreadPoolExecutor(jobs) as pool:
            pending: deque[Future[Floats]] = deque()
            try:
                for start in range(0, len(self), size):
                    ahead = min(start + 2 * size, len(self))
                    pending.extend(
                        pool.submit(self.frame, k) for k in range(start + len(pending), ahead)
                    )
                    count = min(size, len(self) - start)
                    vertices = np.stack([pending.popleft().result() for _ in range(count)])
                    yield Block(self.names[start : start + count], vertices)
            finally:
                for future in pending:
                    future.cancel()


def only(paths: list[Path]) -> Path:
    """The one file of a clip that is not a file a frame."""
    if len(paths) > 1:
        raise InputError(
            f"{paths[0]}: {len(paths)} files that each hold a clip were named, expected one: "
            f"{first_few(path.name for path in paths)}"
        )
    return paths[0]


def refuse_other_faces(faces: Integers, expected: Integers, whose: str = "the rest pose") -> None:
    """Refuse connectivity other than `expected`, that of `whose`, saying where it differs."""
    if len(faces) != len(expected):
        raise InputError(
            f"{len(faces)} triangles, {whose} has {len(expected)}; "
            "frames must share one connectivity"
        )
    differs = np.flatnonzero((faces != expected).any(axis=1))
    if len(differs):
        k = differs[0]
        raise InputError(
            f"triangle {k} joins vertices {_joined(faces[k])}, in {whose} {_joined(expected[k])} "
            f"(counted from 0; {len(differs)} triangles differ); frames must share one connectivity"
        )


def _joined(corners: Integers) -> str:
    return "-".join(map(str, corners))
