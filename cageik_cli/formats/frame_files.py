"""A clip that is one mesh file a frame, in the natural order of the names."""

import hashlib
from collections.abc import Sequence
from typing import Any

from cageik_cli.formats.base.file_names import kind_of, unpacked
from cageik_cli.formats.base.polygons import unfolded
from cageik_cli.formats.base.sequence import ClipRequest, MeshSequence, refuse_other_connectivity
from cageik_cli.formats.mesh_file import MESH_SUFFIXES, file_mesh, read_bytes
from cageik_cli.formats.obj.frames import FrameParser
from cageik_cli.formats.ply import PlyFrameParser
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import located
from cageik_cli.util.text import printable


class Reader(MeshSequence):
    """Frames from mesh files of one kind."""

    suffixes = MESH_SUFFIXES

    def __init__(self, request: ClipRequest) -> None:
        paths = [request.paths[k] for k in request.chosen(len(request.paths))]
        self._paths = paths
        self._kind = kind_of(paths[0])
        self.names = tuple(printable(path.name) for path in paths)
        self._digests: dict[int, bytes] = {}
        with located(paths[0]):
            data = self._read(0)
            mesh = file_mesh(data, self._kind)
            self._fanned = mesh.fanned
            # Its shape decides how polygons are cut, for all frames.
            self.first = unfolded(self._fanned, mesh.sizes)
        self.notes = tuple(f"{self.names[0]}: {note}, as in all frames" for note in mesh.notes)
        self._plain = (
            FrameParser(data, mesh.vertices)
            if self._kind.startswith(".obj")
            else PlyFrameParser(data)
        )

    def positions(self, index: int) -> Floats:
        """Vertices of one file, its faces compared with the first frame's."""
        with located(self._paths[index]):
            data = self._read(index)
            vertices = self._plain.positions(data)
            if vertices is not None:
                return vertices
            mesh = file_mesh(data, self._kind)
            refuse_other_connectivity(len(mesh.vertices), mesh.faces, self.fanned, "the rest pose")
            return mesh.vertices

    @property
    def fanned(self) -> TriMesh:
        """Frame 0 with every polygon as a fan: what connectivity is compared by."""
        return self._fanned

    def place(self, index: int) -> str:
        """The frame's path."""
        return str(self._paths[index])

    def digest(self, index: int) -> bytes:
        """SHA-256 of the frame's file, as it was when it was last read."""
        if index not in self._digests:
            with located(self._paths[index]):
                self._read(index)
        return self._digests[index]

    def recall(self, start: int, stamps: Sequence[bytes]) -> None:
        """Take digests of files from who has read them; a stamp of zeros says nothing."""
        self._digests |= {k: stamp for k, stamp in enumerate(stamps, start) if any(stamp)}

    def source(self) -> dict[str, Any]:
        """Names of the first and last file, their count, and a digest over all in order."""
        digests = b"".join(map(self.stamp, range(len(self))))
        return {
            "name": f"{self.names[0]} ... {self.names[-1]}" if len(self) > 1 else self.names[0],
            "files": len(self),
            "sha256": hashlib.sha256(digests).hexdigest(),
        }

    def _read(self, index: int) -> bytes:
        data = read_bytes(self._paths[index])
        self._digests[index] = hashlib.sha256(data).digest()
        return unpacked(data, self._kind)
