"""A clip that is one mesh file a frame, in the natural order of the names."""

import hashlib
import re
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

from cageik_cli.errors import InputError, located
from cageik_cli.mesh import Floats, TriMesh
from cageik_cli.sequence.clip import MeshSequence, refuse_other_faces
from cageik_cli.sequence.mesh_file import MESH_SUFFIXES, geometry, read_bytes
from cageik_cli.sequence.obj import FrameParser

_NUMBERED = re.compile(r"(.*?)(\d+)(\D*)")


class Reader(MeshSequence):
    """Frames from mesh files of one kind."""

    suffixes = MESH_SUFFIXES

    @classmethod
    def open(cls, paths: list[Path], allow_gaps: bool) -> "Reader":
        """Open the files as frames; `allow_gaps` takes them although a number is missing."""
        if not allow_gaps:
            refuse_gaps(paths)
        return cls(paths)

    def __init__(self, paths: list[Path]) -> None:
        self._paths = paths
        self._suffix = paths[0].suffix.lower()
        self.names = tuple(path.name for path in paths)
        self._digests: dict[int, bytes] = {}
        with located(paths[0]):
            data = read_bytes(paths[0])
            vertices, faces, _ = geometry(data, self._suffix)
            self.first = TriMesh(vertices, faces)
        self._plain = FrameParser(data) if self._suffix == ".obj" else None

    def positions(self, index: int) -> Floats:
        """Vertices of one file, its faces compared with the first frame's."""
        with located(self._paths[index]):
            data = read_bytes(self._paths[index])
            self._digests[index] = hashlib.sha256(data).digest()
            plain = self._plain.positions(data) if self._plain else None
            if plain is not None:
                return plain
            vertices, faces, _ = geometry(data, self._suffix)
            if len(vertices) == len(self.first.vertices):
                refuse_other_faces(faces, self.first.faces)
            return vertices

    def place(self, index: int) -> str:
        """The frame's path."""
        return str(self._paths[index])

    def source(self) -> dict[str, Any]:
        """Names of the first and last file, their count, and a digest over all in order."""
        digests = b"".join(self._digests[k] for k in range(len(self)))
        return {
            "name": f"{self.names[0]} ... {self.names[-1]}" if len(self) > 1 else self.names[0],
            "files": len(self),
            "sha256": hashlib.sha256(digests).hexdigest(),
        }


def refuse_gaps(paths: list[Path]) -> None:
    """Refuse numbered files among which a number is missing."""
    found = [_NUMBERED.fullmatch(path.stem) for path in paths]
    matches = [match for match in found if match]
    around = {(path.parent, m[1], m[3]) for path, m in zip(paths, matches, strict=False)}
    if len(matches) < len(paths) or len(around) != 1:
        return
    numbers = [int(match[2]) for match in matches]
    steps = Counter(b - a for a, b in pairwise(numbers))
    usual = min(steps, key=lambda step: (-steps[step], step), default=0)
    gaps = [k for k, (a, b) in enumerate(pairwise(numbers)) if b - a > usual > 0]
    if gaps:
        first = matches[gaps[0]]
        number = str(int(first[2]) + usual).zfill(len(first[2]))
        lost = f"{first[1]}{number}{first[3]}{paths[0].suffix}"
        raise InputError(
            f"{paths[gaps[0]].parent / lost}: missing between {paths[gaps[0]].name} and "
            f"{paths[gaps[0] + 1].name}, where frames are numbered in steps of {usual} "
            f"({len(gaps)} such gaps); restore it, or take the clip as it is with --allow-gaps"
        )
