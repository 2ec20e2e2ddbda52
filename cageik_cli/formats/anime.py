"""Clips of DeformingThings4D (`.anime`): a mesh, and offsets of its vertices per frame."""

import numpy as np

from cageik_cli.formats.base.binary_frames import (
    ArrayLayout,
    BinaryFile,
    StoredFrames,
    check_file_size,
)
from cageik_cli.formats.base.readers import ArrayClip, ArrayClipFile, single_path
from cageik_cli.formats.base.sequence import ClipRequest
from cageik_cli.util.errors import FormatError

_INT32, _FLOAT32 = np.dtype("<i4"), np.dtype("<f4")


class Reader(ArrayClipFile):
    """Frames of one `.anime`, little-endian: int32 F, m, t; v0 (m, 3); faces; offsets (F - 1)."""

    suffixes = (".anime",)

    @classmethod
    def open_clip(cls, request: ClipRequest) -> ArrayClip:
        """Read the faces and frame 0, and find the offsets of the others."""
        file = BinaryFile.open(single_path(request.paths))
        if file.size < 12:
            raise FormatError(f"{file.size} bytes, an .anime file has at least 12; copy it again")
        frames, vertices, triangles = map(int, file.read_array(0, _INT32, (3,)))
        check_file_size(
            file,
            12 + 12 * frames * vertices + 12 * triangles,
            {"frames": frames, "vertices": vertices, "triangles": triangles},
        )
        first = file.read_array(12, _FLOAT32, (vertices, 3))
        faces = file.read_array(12 + 12 * vertices, _INT32, (triangles, 3))
        offset = 12 + 12 * (vertices + triangles)
        offsets = StoredFrames(file, ArrayLayout(offset, _FLOAT32, frames - 1, vertices))
        return ArrayClip(_OffsetFrames(first, offsets), faces)


class _OffsetFrames:
    """Frames that are stored as offsets from frame 0."""

    def __init__(self, first: np.ndarray, offsets: StoredFrames) -> None:
        with np.errstate(invalid="ignore"):  # checked when the frame is read
            self._first, self._offsets = first.astype(np.float64), offsets
        self.frame_count, self.vertex_count = offsets.frame_count + 1, offsets.vertex_count

    def read_frame(self, index: int) -> np.ndarray:
        """Read the positions of one frame, (m, 3)."""
        if index == 0:
            return self._first
        with np.errstate(invalid="ignore"):
            return np.asarray(self._first + self._offsets.read_frame(index - 1))
