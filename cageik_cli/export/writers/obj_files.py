"""A folder of Wavefront OBJ files, one a frame."""

from pathlib import Path

from cageik_cli.export.animation import Animation
from cageik_cli.export.frame_files import FrameFileWriter
from cageik_cli.mesh import Floats


class Writer(FrameFileWriter):
    """Vertices with nine digits, which tell all float32 apart, and triangles."""

    suffixes = (".obj",)

    def __init__(self, target: Path, animation: Animation) -> None:
        super().__init__(target, animation)
        rest = animation.rest
        # One format of the whole file is several times as quick as one a line.
        faces = b"f %d %d %d\n" * len(rest.faces) % tuple((rest.faces + 1).ravel().tolist())
        self._format = b"v %.9g %.9g %.9g\n" * len(rest.vertices) + faces

    def content(self, positions: Floats) -> bytes:
        """The text of one frame."""
        return self._format % tuple(positions.ravel().tolist())
