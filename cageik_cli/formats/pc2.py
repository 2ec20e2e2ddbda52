"""PC2 point caches: a header of 32 bytes and float32 positions, little-endian."""

import struct
from math import isfinite
from pathlib import Path

import numpy as np

from cageik_cli.formats.base.binary_frames import (
    ArrayLayout,
    BinaryFile,
    StoredFrames,
    check_file_size,
)
from cageik_cli.formats.base.readers import ArrayClip, ArrayClipFile, single_path
from cageik_cli.formats.base.sequence import ClipRequest
from cageik_cli.formats.base.writers import Animation, PointCacheWriter, make_blender_notes
from cageik_cli.formats.settings import SceneHints
from cageik_cli.util.errors import FormatError

_HEADER = struct.Struct("<12siiffi")
_MAGIC = b"POINTCACHE2\0"


class Reader(ArrayClipFile):
    """Frames of one `.pc2`."""

    suffixes = (".pc2",)

    @classmethod
    def open_clip(cls, request: ClipRequest) -> ArrayClip:
        """Find the frames, and their numbers."""
        file = BinaryFile.open(single_path(request.paths))
        if file.size < _HEADER.size:
            raise FormatError(f"{file.size} bytes, a PC2 file has at least 32; export it again")
        header = file.read_array(0, np.dtype(np.uint8), (_HEADER.size,)).tobytes()
        magic, version, vertices, start, rate, frames = _HEADER.unpack(header)
        if magic != _MAGIC or version != 1:
            raise FormatError(
                f"begins with {magic!r} and version {version}, expected {_MAGIC!r} and version 1; "
                "it is not a PC2 file that can be read, export it again"
            )
        check_file_size(file, 32 + 12 * frames * vertices, {"frames": frames, "vertices": vertices})
        if not isfinite(start) or not 0 < rate < float("inf"):
            raise FormatError(
                f"starts at frame {start} with a sample every {rate} frames, expected a finite "
                "start and a step above zero; export it again"
            )
        layout = ArrayLayout(32, np.dtype("<f4"), frames, vertices)
        step = None if rate == 1 else rate
        scene = SceneHints(start=start, frame_step=step)
        return ArrayClip(StoredFrames(file, layout), None, scene)


class Writer(PointCacheWriter):
    """Writes a sample per frame, with the number of the first and the step of numbers."""

    suffixes = (".pc2",)
    dtype = "<f4"

    def __init__(self, target: Path, animation: Animation) -> None:
        super().__init__(target, animation)
        self.notes = make_blender_notes(animation.scene)

    def make_header(self, animation: Animation) -> bytes:
        """Return the 32 bytes before the first sample."""
        count, scene = len(animation.rest.vertices), animation.scene
        return _HEADER.pack(_MAGIC, 1, count, scene.start, scene.frame_step, animation.frame_count)
