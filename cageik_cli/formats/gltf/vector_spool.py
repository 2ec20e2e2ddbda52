"""Frames of vectors in a temporary file, read back some vertices at a time."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from cageik_cli.formats.gltf.glb_file import Singles
from cageik_cli.util.arrays import Floats

BLOCK_BYTES = 1 << 25
"""Bytes of the vectors of all frames that are read together; the last digits depend on it."""


class VectorSpool:
    """F frames of m vectors, written frame by frame and read for all frames together.

    Parameters
    ----------
    folder : Path
        Of the temporary file.
    vertex_count : int
        m.
    """

    def __init__(self, folder: Path, vertex_count: int) -> None:
        self.frame_count, self.vertex_count = 0, vertex_count
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  # closed by `close`

    def append(self, vectors: Singles) -> None:
        """Write the vectors (m, 3) of the next frame."""
        self._file.write(np.ascontiguousarray(vectors, np.float32).data)
        self.frame_count += 1

    def read_blocks(self, start: int, stop: int) -> Iterator[tuple[int, Floats]]:
        """Yield the first vertex of each block of vertices, and vectors (F, 3 b) of all frames."""
        size = max(1, BLOCK_BYTES // (24 * max(1, self.frame_count)))
        for first in range(start, stop, size):
            yield first, self._read(first, min(first + size, stop))

    def close(self) -> None:
        """Delete the temporary file."""
        self._file.close()

    def _read(self, start: int, stop: int) -> Floats:
        block = np.empty((self.frame_count, 3 * (stop - start)), np.float32)
        for frame, row in enumerate(block):
            self._file.seek(12 * (frame * self.vertex_count + start))
            self._file.readinto(row.data)
        return block.astype(np.float64)
