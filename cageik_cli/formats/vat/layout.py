"""Where a vertex and a frame are in a texture, as OpenVAT has it.

Vertices are columns. Where there are more than the texture is wide, they go on in a block of rows
below. A block has a row per frame, so a shader goes down a row from one frame to the next.
"""

from dataclasses import dataclass

import numpy as np

from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import OutputError
from cageik_cli.util.messages import say
from cageik_cli.util.text import format_count

MAX_SIDE = 8192
"""Texels along a side, at most, which graphics cards of desktops and consoles read."""

SAFE_SIDE = 4096
"""What nearly all phones and browsers read, too."""


@dataclass(frozen=True, slots=True)
class TextureLayout:
    """Places of vertices in a texture of `width` times `height` texels, which are powers of two.

    Engines scale textures of other sizes as they import them, and mix the vertices.
    """

    vertex_count: int
    frame_count: int
    width: int
    height: int

    @staticmethod
    def choose(vertex_count: int, frame_count: int) -> "TextureLayout":
        """Choose the smallest texture, and of these the most square.

        Raises
        ------
        OutputError
            When a side would have more than `MAX_SIDE` texels.
        """
        sizes = []
        for power in range(MAX_SIDE.bit_length()):
            blocks = -(-vertex_count // 2**power)
            height = 1 << (blocks * frame_count - 1).bit_length()
            sizes.append((2**power * height, max(2**power, height), 2**power, height))
        fitting = [size for size in sizes if size[1] <= MAX_SIDE]
        if not fitting:
            raise OutputError(
                f"{format_count(frame_count, 'frame')} of {format_count(vertex_count, 'vertex')} "
                f"have no place in a texture of {MAX_SIDE} times {MAX_SIDE} texels; write fewer "
                "frames, " + say("a `mesh=` of fewer vertices, or .abc")
            )
        *_, width, height = min(fitting)
        return TextureLayout(vertex_count, frame_count, width, height)

    def list_rows(self) -> list[tuple[int, int, int]]:
        """Return the frame of each row that is used, and its first vertex and the one past it."""
        starts = range(0, self.vertex_count, self.width)
        return [
            (frame, start, min(start + self.width, self.vertex_count))
            for start in starts
            for frame in range(self.frame_count)
        ]

    def locate(self, vertices: Integers) -> Floats:
        """Return the texel of vertices in the first frame, (k, 2), as UVs with v downward."""
        blocks, columns = np.divmod(vertices, self.width)
        texels = np.stack([columns, blocks * self.frame_count], axis=1)
        return np.asarray((texels + 0.5) / (self.width, self.height))
