"""A clip: frames of one connectivity, read when they are asked for."""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.errors import InputError, first_few, located
from cageik_cli.mesh import Floats, Integers, TriMesh, checked_positions


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
    notes : tuple of str
        What was changed in the frames, one sentence each.
    """

    suffixes: tuple[str, ...]
    names: tuple[str, ...]
    first: TriMesh
    notes: tuple[str, ...] = ()

    @abstractmethod
    def __init__(self, paths: list[Path]) -> None:
        """Open the clip that `paths`, in order, all of one suffix, hold."""

    @abstractmethod
    def positions(self, index: int) -> np.ndarray:
        """Vertices of one frame as the file has them, in the connectivity of `first`."""

    @abstractmethod
    def source(self) -> dict[str, Any]:
        """Name and digest of what was read; complete once every frame was."""

    @property
    def fanned(self) -> TriMesh:
        """Frame 0 with every polygon as a fan: what connectivity is compared by."""
        return self.first

    def __len__(self) -> int:
        return len(self.names)

    def place(self, index: int) -> str:
        """Where a frame is, for messages."""
        return self.names[index]

    def frame(self, index: int) -> Floats:
        """Vertices of one frame, (m, 3), as many as the first has and all finite.

        Raises
        ------
        InputError
            Naming the frame.
        """
        positions = self.positions(index)
        with located(self.place(index)):
            refuse_other_connectivity(len(positions), self.first.faces, self.first, "the rest pose")
            return checked_positions(positions)

    def blocks(self, size: int, jobs: int) -> Iterator[Floats]:
        """All frames in order, at most `size` in a block (k, m, 3), read ahead by `jobs` threads.

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
                    yield np.stack([pending.popleft().result() for _ in range(count)])
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


def refuse_other_connectivity(count: int, faces: Integers, expected: TriMesh, whose: str) -> None:
    """Refuse a mesh of `count` vertices and `faces` that is not `whose`, saying where it differs.

    Raises
    ------
    InputError
    """
    for noun, found, wanted in (
        ("vertices", count, len(expected.vertices)),
        ("triangles", len(faces), len(expected.faces)),
    ):
        if found != wanted:
            raise InputError(
                f"{found} {noun}, {whose} has {wanted}; all must share one connectivity"
            )
    if faces is expected.faces:
        return
    differs = np.flatnonzero((faces != expected.faces).any(axis=1))
    if len(differs):
        k = differs[0]
        raise InputError(
            f"triangle {k} joins vertices {_joined(faces[k])}, in {whose} "
            f"{_joined(expected.faces[k])} (counted from 0; {len(differs)} triangles differ); "
            "all must share one connectivity"
        )


def _joined(corners: Integers) -> str:
    return "-".join(map(str, corners))
