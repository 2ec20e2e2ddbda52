"""A clip of one mesh file per frame, in the natural order of the names."""

import hashlib
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from cageik_cli.formats.base.file_data import decompress
from cageik_cli.formats.base.file_names import file_suffix
from cageik_cli.formats.base.file_numbers import number_files
from cageik_cli.formats.base.mesh_data import FileMesh, check_not_points
from cageik_cli.formats.base.sequence import ClipRequest, MeshSequence, check_connectivity
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FormatError, MissingFrameError, error_context
from cageik_cli.util.files import read_input
from cageik_cli.util.text import to_unicode


class FrameParser(Protocol):
    """Reads frames whose faces are known from a first frame."""

    def parse_positions(self, data: bytes) -> Floats | None:
        """Return the vertices (m, 3) if all faces are the first frame's, else None."""


class FrameFileReader(MeshSequence):
    """Frames from mesh files of one suffix; a format subclasses this and says how to parse a file.

    The same class reads single meshes, see `formats.mesh_file.load_mesh`. Names that end in `.gz`
    are unpacked first, where a format lists such suffixes (`file_data.with_gzip`).
    """

    @classmethod
    @abstractmethod
    def parse(cls, data: bytes) -> FileMesh:
        """Parse the content of a file, which is not empty.

        Raises
        ------
        FormatError
            Without the file's name.
        """

    @classmethod
    def make_frame_parser(cls, data: bytes, mesh: FileMesh) -> FrameParser | None:
        """Return a quicker way to read frames like the first, which holds `data` and `mesh`."""
        return None

    @classmethod
    def read_attributes(cls, data: bytes, mesh: FileMesh) -> FileMesh:
        """Return what was parsed with all else that the file, unpacked, says of the surface.

        Frames are compared and solved without it, so only the first frame's is read.
        """
        return mesh

    @classmethod
    def read_library(cls, path: Path, mesh: FileMesh) -> FileMesh:
        """Return a mesh with what the files say that the file at `path` names."""
        return mesh

    def __init__(self, request: ClipRequest) -> None:
        series = number_files(request.paths, request.settings.gaps)
        chosen = series.trim(request.select_frames(len(series.paths)))
        self._missing = {k: series.missing[n] for k, n in enumerate(chosen) if n in series.missing}
        self.missing = frozenset(self._missing)
        self.scene = series.scene.restrict_to_frames(chosen)
        self._paths = paths = [series.paths[n] for n in chosen]
        self._suffix = file_suffix(paths[0])
        self.names = tuple(to_unicode(path.name) for path in paths)
        self._digests: dict[int, bytes] = {}
        with error_context(paths[0]):
            data = self._read(0)
            parsed = parse_mesh(type(self), data)
            completed = replace(parsed, vertices=request.complete_first(parsed.vertices))
            mesh = self.read_library(paths[0], self.read_attributes(data, completed))
            # Its shape decides how polygons are cut, for all frames.
            self.first = mesh.make_mesh()
        notes = (f"{self.names[0]}: {note}, as in all frames" for note in mesh.notes)
        self.notes = (*series.notes, *notes)
        self._frame_parser = self.make_frame_parser(data, parsed)

    def read_positions(self, index: int) -> Floats:
        """Read the vertices of one file, and compare its faces with the first frame's."""
        with error_context(self._paths[index]):
            data = self._read(index)
            parser = self._frame_parser
            vertices = parser.parse_positions(data) if parser is not None else None
            if vertices is not None:
                return vertices
            mesh = parse_mesh(type(self), data)
            expected = self.first.fan_triangulated
            check_connectivity(len(mesh.vertices), mesh.faces, expected, "the rest pose")
            return mesh.vertices

    def location(self, index: int) -> str:
        """Return the frame's path."""
        return str(self._paths[index])

    def digest(self, index: int) -> bytes:
        """Return the SHA-256 digest of the frame's file, as it was when it was last read."""
        if index not in self._digests:
            with error_context(self._paths[index]):
                self._read(index)
        return self._digests[index]

    def set_digests(self, start: int, digests: Sequence[bytes]) -> None:
        """Take digests of files that were read elsewhere; zeros stand for an unknown digest."""
        self._digests |= {k: digest for k, digest in enumerate(digests, start) if any(digest)}

    def describe_source(self) -> dict[str, Any]:
        """Return the names of the first and last file, their count, and a digest over all."""
        digests = b"".join(map(self.digest_or_zeros, range(len(self))))
        return {
            "name": f"{self.names[0]} ... {self.names[-1]}" if len(self) > 1 else self.names[0],
            "files": len(self) - len(self.missing),
            "sha256": hashlib.sha256(digests).hexdigest(),
        }

    def _read(self, index: int) -> bytes:
        if index in self._missing:
            raise MissingFrameError(self._missing[index])
        data = read_input(self._paths[index])
        self._digests[index] = hashlib.sha256(data).digest()
        return decompress(data, self._suffix)


def parse_mesh(reader: type[FrameFileReader], data: bytes) -> FileMesh:
    """Parse the content of a mesh file, unpacked.

    Raises
    ------
    FormatError
        When it is empty, a point cloud, or no mesh of the reader's format.
    """
    if not data:
        raise FormatError("the file is empty, expected a mesh; export it again")
    mesh = reader.parse(data)
    check_not_points(len(mesh.vertices), len(mesh.faces))
    return mesh
