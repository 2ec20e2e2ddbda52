"""A clip that one file holds."""

import hashlib
from functools import cached_property
from pathlib import Path
from typing import Any

from cageik_cli.errors import InputError, first_few, located
from cageik_cli.layout import printable
from cageik_cli.mesh import TriMesh
from cageik_cli.sequence.clip import ClipRequest, MeshSequence


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

    def take(self, request: ClipRequest, count: int) -> None:
        """Take those of the file's `count` frames that are asked for, and name them."""
        self.path = only(request.paths)
        self.numbers = request.chosen(count)
        member = f"::{request.member}" if request.member is not None else ""
        name = printable(self.path.name + member)
        self.names = tuple(f"{name}[{k}]" for k in self.numbers)

    def take_faces(self, request: ClipRequest) -> None:
        """Take the rest pose's faces, for a file that holds positions alone.

        Raises
        ------
        InputError
            When no rest pose is given.
        """
        if request.rest is None:
            raise InputError("holds positions and no faces; give a mesh that has them with --rest")
        positions = self.frame_of(0, len(request.rest.mesh.vertices))
        self.first = TriMesh(positions, request.rest.mesh.faces)
        self._fanned = TriMesh(positions, request.rest.fanned.faces)

    def frame_of(self, index: int, count: int) -> Any:
        """Positions of a frame, which has `count` vertices."""
        positions = self.positions(index)
        if len(positions) != count:
            raise InputError(
                f"{len(positions)} vertices, the rest pose has {count}; all must share one "
                "connectivity"
            )
        return positions

    @property
    def fanned(self) -> TriMesh:
        """Frame 0 with every polygon as a fan: what connectivity is compared by."""
        return self._fanned or self.first

    def digest(self, index: int) -> bytes:
        """SHA-256 of the file."""
        return self._digest

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


def only(paths: tuple[Path, ...]) -> Path:
    """The one file of a clip that is not a file a frame."""
    if len(paths) > 1:
        raise InputError(
            f"{paths[0]}: {len(paths)} files that each hold a clip were named, expected one: "
            f"{first_few(path.name for path in paths)}"
        )
    return paths[0]
