"""PC2 point caches: a header of 32 bytes and float32 positions, little-endian."""

import struct
from math import isfinite
from pathlib import Path

import numpy as np

from cageik_cli.formats.base.binary_frames import (
    BinaryFile,
    Packing,
    StoredFrames,
    refuse_other_size,
)
from cageik_cli.formats.base.clip_file import PackedClip, PackedClipFile, only
from cageik_cli.formats.base.sequence import ClipRequest
from cageik_cli.formats.base.writer import Animation, PointCacheWriter, blender_note
from cageik_cli.formats.scene import SceneHints
from cageik_cli.util.errors import InputError

_HEADER = struct.Struct("<12siiffi")
_MAGIC = b"POINTCACHE2\0"


class Reader(PackedClipFile):
    """Frames of one `.pc2`."""

    suffixes = (".pc2",)

    @classmethod
    def opened(cls, request: ClipRequest) -> PackedClip:
        """Find frames, and the first one's number."""
        file = BinaryFile.at(only(request.paths))
        if file.size < _HEADER.size:
            raise InputError(f"{file.size} bytes, a PC2 file has 32 at least; export it again")
        header = file.numbers(0, np.dtype(np.uint8), (_HEADER.size,)).tobytes()
        magic, version, vertices, start, rate, frames = _HEADER.unpack(header)
        if magic != _MAGIC or version != 1:
            raise InputError(
                f"begins with {magic!r} and version {version}, expected {_MAGIC!r} and version 1; "
                "it is no PC2 file of a kind read here"
            )
        refuse_other_size(
            file, 32 + 12 * frames * vertices, {"frames": frames, "vertices": vertices}
        )
        if not isfinite(start) or not 0 < rate < float("inf"):
            raise InputError(
                f"starts at frame {start} with a sample every {rate} frames, expected a finite "
                "start and a rate above zero; export it again"
            )
        packing = Packing(32, np.dtype("<f4"), frames, vertices)
        return PackedClip(StoredFrames(file, packing), None, SceneHints(start=start), _notes(rate))


def _notes(rate: float) -> tuple[str, ...]:
    if rate == 1:
        return ()
    return (
        f"holds a sample every {rate:g} frames of its scene, and each is taken as a frame; the "
        f"frames a second are those of the scene divided by {rate:g}: give --fps",
    )


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
