"""MDD, the point cache of LightWave, Maya and Blender: big-endian.

int32 samples, int32 vertices, float32 time of each sample in seconds, then float32 positions,
sample by sample.
"""

import struct
from pathlib import Path

import numpy as np

from cageik_cli.export.animation import Animation
from cageik_cli.export.point_cache import PointCacheWriter, blender_note


class Writer(PointCacheWriter):
    """A sample a frame, at the time of the frame's number in the scene."""

    suffixes = (".mdd",)
    kind = ">f4"

    def __init__(self, target: Path, animation: Animation) -> None:
        super().__init__(target, animation)
        self.notes = blender_note(animation.scene.start)

    def header(self, animation: Animation) -> bytes:
        """Both counts, and the times."""
        scene = animation.scene
        times = (scene.start + np.arange(animation.count)) / scene.fps
        counts = struct.pack(">ii", animation.count, len(animation.rest.vertices))
        return counts + times.astype(">f4").tobytes()
