"""Clips of DeformingThings4D: a mesh, and how far its vertices are from there in each frame."""

import numpy as np

from cageik_cli.formats.base.binary_frames import (
    BinaryFile,
    Packing,
    StoredFrames,
    refuse_other_size,
)
from cageik_cli.formats.base.clip_file import PackedClip, PackedClipFile, only
from cageik_cli.formats.base.sequence import ClipRequest
from cageik_cli.util.errors import InputError

_WHOLE, _SINGLE = np.dtype("<i4"), np.dtype("<f4")


class Reader(PackedClipFile):
    """Frames of one `.anime`, little-endian: int32 F, m, t; v0 (m, 3); faces; offsets (F - 1)."""

    suffixes = (".anime",)

    @classmethod
    def opened(cls, request: ClipRequest) -> PackedClip:
        """Read faces and frame 0, and find the offsets of the others."""
        file = BinaryFile.at(only(request.paths))
        if file.size < 12:
            raise InputError(f"{file.size} bytes, an .anime file has 12 at least; copy it again")
        frames, vertices, triangles = map(int, file.numbers(0, _WHOLE, (3,)))
        refuse_other_size(
            file,
            12 + 12 * frames * vertices + 12 * triangles,
            {"frames": frames, "vertices": vertices, "triangles": triangles},
        )
        first = file.numbers(12, _SINGLE, (vertices, 3))
        faces = file.numbers(12 + 12 * vertices, _WHOLE, (triangles, 3))
        place = 12 + 12 * (vertices + triangles)
        offsets = StoredFrames(file, Packing(place, _SINGLE, frames - 1, vertices))
        return PackedClip(_FromFirst(first, offsets), faces)


class _FromFirst:
    """Frames that are kept as offsets from frame 0."""

    def __init__(self, first: np.ndarray, offsets: StoredFrames) -> None:
        with np.errstate(invalid="ignore"):  # frames are checked where they enter
            self._first, self._offsets = first.astype(np.float64), offsets
        self.count, self.vertices = offsets.count + 1, offsets.vertices

    def frame(self, index: int) -> np.ndarray:
        """Positions of one frame, (m, 3)."""
        if index == 0:
            return self._first
        with np.errstate(invalid="ignore"):
            return np.asarray(self._first + self._offsets.frame(index - 1))
