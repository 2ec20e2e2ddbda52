"""A clip that is one mesh file a frame, in the natural order of the names."""

import hashlib
from collections.abc import Sequence
from typing import Any

from cageik_cli.formats.base.file_names import decompress, file_suffix
from cageik_cli.formats.base.polygons import replace_folded_fans
from cageik_cli.formats.base.sequence import ClipRequest, MeshSequence, check_connectivity
from cageik_cli.formats.mesh_file import MESH_SUFFIXES, parse_mesh, read_bytes
from cageik_cli.formats.obj.frames import ObjFrameParser
from cageik_cli.formats.ply import PlyFrameParser
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import error_context
from cageik_cli.util.text import to_unicode


class Reader(MeshSequence):
    """Frames from mesh files of one kind."""

    suffixes = MESH_SUFFIXES

    def __init__(self, request: ClipRequest) -> None:
        paths = [request.paths[k] for k in request.select_frames(len(request.paths))]
        self._paths = paths
        self._suffix = file_suffix(paths[0])
        self.names = tuple(to_unicode(path.name) for path in paths)
        self._digests: dict[int, bytes] = {}
        with error_context(paths[0]):
            data = self._read(0)
            mesh = parse_mesh(data, self._suffix)
            self._fan_triangulated = mesh.fan_triangulated
            # Its shape decides how polygons are cut, for all frames.
            self.first = replace_folded_fans(self._fan_triangulated, mesh.corner_counts)
        self.notes = tuple(f"{self.names[0]}: {note}, as in all frames" for note in mesh.notes)
        self._frame_parser = (
            ObjFrameParser(data, mesh.vertices)
            if self._suffix.startswith(".obj")
            else PlyFrameParser(data)
        )

    def read_positions(self, index: int) -> Floats:
        """Vertices of one file, its faces compared with the first frame's."""
        with error_context(self._paths[index]):
            data = self._read(index)
            vertices = self._frame_parser.parse_positions(data)
            if vertices is not None:
                return vertices
            mesh = parse_mesh(data, self._suffix)
            check_connectivity(
                len(mesh.vertices), mesh.faces, self.fan_triangulated, "the rest pose"
            )
            return mesh.vertices

    @property
    def fan_triangulated(self) -> TriMesh:
        """Frame 0 with every polygon as a fan: what connectivity is compared by."""
        return self._fan_triangulated

    def location(self, index: int) -> str:
        """The frame's path."""
        return str(self._paths[index])

    def digest(self, index: int) -> bytes:
        """SHA-256 of the frame's file, as it was when it was last read."""
        if index not in self._digests:
            with error_context(self._paths[index]):
                self._read(index)
        return self._digests[index]

    def set_digests(self, start: int, digests: Sequence[bytes]) -> None:
        """Take digests of files from who has read them; a stamp of zeros says nothing."""
        self._digests |= {k: stamp for k, stamp in enumerate(digests, start) if any(stamp)}

    def describe_source(self) -> dict[str, Any]:
        """Names of the first and last file, their count, and a digest over all in order."""
        digests = b"".join(map(self.digest_or_zeros, range(len(self))))
        return {
            "name": f"{self.names[0]} ... {self.names[-1]}" if len(self) > 1 else self.names[0],
            "files": len(self),
            "sha256": hashlib.sha256(digests).hexdigest(),
        }

    def _read(self, index: int) -> bytes:
        data = read_bytes(self._paths[index])
        self._digests[index] = hashlib.sha256(data).digest()
        return decompress(data, self._suffix)
