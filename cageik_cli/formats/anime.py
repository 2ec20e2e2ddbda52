"""Clips of DeformingThings4D (`.anime`): a mesh, and offsets of its vertices per frame."""

import numpy as np

from cageik_cli.formats.base.readers import (
    ArrayClip,
    ArrayClipFile,
    BinaryFile,
    ChunkedFrames,
    StoredFrames,
    check_file_size,
)
from cageik_cli.formats.base.sequence import ClipRequest


class Reader(ArrayClipFile):
    """Frames of one `.anime`, little-endian: int32 F, m, t; v0 (m, 3); faces; offsets (F - 1)."""

    suffixes = (".anime",)

    @classmethod
    def open_clip(cls, request: ClipRequest) -> ArrayClip:
        """Read the faces and frame 0, and find the offsets of the others."""
        file = BinaryFile.open(request.path)
        frames, vertices, triangles = file.read_header("<3i", "an .anime file")
        check_file_size(
            file,
            12 + 12 * frames * vertices + 12 * triangles,
            {"frames": frames, "vertices": vertices, "triangles": triangles},
        )
        float32 = np.dtype("<f4")
        first = file.read_array(12, float32, (vertices, 3))
        faces = file.read_array(12 + 12 * vertices, np.dtype("<i4"), (triangles, 3))
        place = 12 + 12 * (vertices + triangles)
        offsets = StoredFrames(file, place, float32, frame_count=frames - 1, vertex_count=vertices)
        return ArrayClip(_OffsetFrames(first, offsets), faces)


class _OffsetFrames(ChunkedFrames):
    """Frames that are stored as offsets from frame 0."""

    def __init__(self, first: np.ndarray, offsets: StoredFrames) -> None:
        with np.errstate(invalid="ignore"):  # checked when the frame is read
            self._first, self._offsets = first.astype(np.float64), offsets
        super().__init__(offsets.frame_count + 1, offsets.vertex_count, chunk_frames=1, itemsize=8)

    def read_chunk(self, start: int, stop: int) -> np.ndarray:
        """Read frame `start`, (1, m, 3)."""
        if start == 0:
            return self._first[None]
        with np.errstate(invalid="ignore"):
            return np.asarray(self._first + self._offsets.read_frame(start - 1))[None]
