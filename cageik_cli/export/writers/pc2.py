"""PC2, the point cache of Max and Blender: little-endian.

12 bytes `POINTCACHE2` and a zero, int32 version 1, int32 vertices, float32 number of the first
frame, float32 frames a sample, int32 samples, then float32 positions, sample by sample.
"""

import struct
from pathlib import Path

from cageik_cli.export.animation import Animation
from cageik_cli.export.point_cache import PointCacheWriter, blender_note


class Writer(PointCacheWriter):
    """A sample a frame, the first at the scene's start."""

    suffixes = (".pc2",)
    kind = "<f4"

    def __init__(self, target: Path, animation: Animation) -> None:
        super().__init__(target, animation)
        self.notes = blender_note(animation.scene.start)

    def header(self, animation: Animation) -> bytes:
        """The 32 bytes before the first sample."""
        count, start = len(animation.rest.vertices), animation.scene.start
        return struct.pack("<12siiffi", b"POINTCACHE2\0", 1, count, start, 1.0, animation.count)
