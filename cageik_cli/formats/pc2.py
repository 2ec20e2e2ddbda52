"""PC2 point caches: a header of 32 bytes and float32 positions, little-endian."""

import struct
from math import isfinite

import numpy as np

from cageik_cli.formats.base.readers import (
    ArrayClip,
    ArrayClipFile,
    BinaryFile,
    StoredFrames,
    check_file_size,
)
from cageik_cli.formats.base.sequence import ClipRequest
from cageik_cli.formats.base.writers import Animation, PointCacheWriter
from cageik_cli.formats.settings import SceneHints
from cageik_cli.util.errors import FormatError

HEADER = "<12siiffi"
"""The name of the format, its version, the number of vertices, the number of the first frame, the
step from a sample to the next in frames, and the number of samples; 32 bytes."""

MAGIC = b"POINTCACHE2\0"
"""What a file begins with."""


class Reader(ArrayClipFile):
    """Frames of one `.pc2`."""

    suffixes = (".pc2",)

    @classmethod
    def open_clip(cls, request: ClipRequest) -> ArrayClip:
        """Find the frames, and their numbers."""
        file = BinaryFile.open(request.path)
        magic, version, vertices, start, rate, frames = file.read_header(HEADER, "a PC2 file")
        if magic != MAGIC or version != 1:
            raise FormatError(
                f"begins with {magic!r} and version {version}, expected {MAGIC!r} and version 1; "
                "it is not a PC2 file that can be read, export it again"
            )
        check_file_size(file, 32 + 12 * frames * vertices, {"frames": frames, "vertices": vertices})
        if not isfinite(start) or not 0 < rate < float("inf"):
            raise FormatError(
                f"starts at frame {start} with a sample every {rate} frames, expected a finite "
                "start and a step above zero; export it again"
            )
        stored = StoredFrames(file, 32, np.dtype("<f4"), frame_count=frames, vertex_count=vertices)
        scene = SceneHints(start=start, frame_step=None if rate == 1 else rate)
        return ArrayClip(stored, None, scene)


class Writer(PointCacheWriter):
    """Writes a sample per frame, with the number of the first and the step of numbers."""

    suffixes = (".pc2",)
    dtype = "<f4"

    def make_header(self, animation: Animation) -> bytes:
        """Return the 32 bytes before the first sample."""
        count, scene = len(animation.rest.vertices), animation.scene
        return struct.pack(
            HEADER, MAGIC, 1, count, scene.start, scene.frame_step, animation.frame_count
        )
