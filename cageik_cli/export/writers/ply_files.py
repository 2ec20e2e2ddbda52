"""A folder of PLY files, one a frame."""

from pathlib import Path

import numpy as np

from cageik_cli.export.animation import Animation
from cageik_cli.export.frame_files import FrameFileWriter
from cageik_cli.util.arrays import Floats

_HEADER = """\
ply
format binary_little_endian 1.0
element vertex {vertices}
property double x
property double y
property double z
element face {faces}
property list uchar int vertex_indices
end_header
"""


class Writer(FrameFileWriter):
    """Binary, little-endian, in double precision: every digit is kept."""

    suffixes = (".ply",)

    def __init__(self, target: Path, animation: Animation) -> None:
        super().__init__(target, animation)
        rest = animation.rest
        counts = {"vertices": len(rest.vertices), "faces": len(rest.faces)}
        faces = np.empty(len(rest.faces), [("corners", "u1"), ("vertices", "<i4", 3)])
        faces["corners"], faces["vertices"] = 3, rest.faces
        self._head, self._tail = _HEADER.format(**counts).encode(), faces.tobytes()

    def content(self, positions: Floats) -> bytes:
        """The bytes of one frame."""
        return self._head + positions.astype("<f8").tobytes() + self._tail
