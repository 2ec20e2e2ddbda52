"""A folder of Wavefront OBJ files, one a frame."""

from pathlib import Path

from cageik_cli.export.animation import Animation
from cageik_cli.export.frame_files import FrameFileWriter
from cageik_cli.export.obj_text import obj_format
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats


class Writer(FrameFileWriter):
    """Vertices with nine digits, which tell all float32 apart.

    All else is as in the OBJ file that the mesh was read from, if it was one, but for normals;
    without one they are triangles and nothing more.
    """

    suffixes = (".obj",)

    def __init__(self, target: Path, animation: Animation) -> None:
        super().__init__(target, animation)
        # One format of the whole file is several times as quick as one a line.
        text = animation.text
        self._format = obj_format(text) if text else _triangles(animation.rest)

    def content(self, positions: Floats) -> bytes:
        """The text of one frame."""
        return self._format % tuple(positions.ravel().tolist())


def _triangles(mesh: TriMesh) -> bytes:
    """A format of vertices and faces alone."""
    faces = b"f %d %d %d\n" * len(mesh.faces) % tuple((mesh.faces + 1).ravel().tolist())
    return b"v %.9g %.9g %.9g\n" * len(mesh.vertices) + faces
