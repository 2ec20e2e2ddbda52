"""Solved frames as bytes, for the log of a run."""

import hashlib
import io
import json
import struct
from dataclasses import dataclass

import numpy as np

from cageik_cli.formats.base.sequence import Block
from cageik_cli.metrics import FrameFigures, Measured
from cageik_cli.store.result_figures import FIGURES, WHOLE_FIGURES
from cageik_cli.util.arrays import Floats
from cageik_cli.util.text import printable

DIGEST_BYTES = hashlib.sha256().digest_size
_COUNTS = struct.Struct("<QQQ")  # first frame, frames, bytes of the faults


@dataclass(frozen=True, slots=True, eq=False)
class SolvedBlock:
    """Consecutive frames, solved and measured.

    Attributes
    ----------
    start : int
        Number of the first.
    cages : (k, n, 3) float64
        nan for a frame that was skipped.
    figures : FrameFigures
    squares : (m,) float64
        Of each vertex, |v̂ − v|² summed over the frames that were not skipped; nan for missing data.
    digests : tuple of bytes
        SHA-256 of the file of each frame; zeros for one that cannot be read.
    faults : dict
        By number in the clip, why a frame was skipped.
    """

    start: int
    cages: Floats
    figures: FrameFigures
    squares: Floats
    digests: tuple[bytes, ...]
    faults: dict[int, str]

    @property
    def stop(self) -> int:
        """Number of the frame after the last."""
        return self.start + len(self.cages)

    def cage(self, frame: int) -> Floats:
        """That of the frame of this number in the clip, (n, 3)."""
        return np.asarray(self.cages[frame - self.start])


def solved(
    block: Block, cages: Floats, measured: Measured, digests: tuple[bytes, ...]
) -> SolvedBlock:
    """A block's cages and figures; those of frames that could not be read become gaps."""
    faults = {k: printable(str(error)) for k, error in block.faults.items()}
    figures, squares = measured.figures, measured.squares
    if faults:
        gaps = np.array(list(faults)) - block.start
        squares = np.delete(squares, gaps, axis=0)
        columns = {name: getattr(figures, name).copy() for name in FIGURES}
        for name, column in columns.items():
            column[gaps] = -1 if name in WHOLE_FIGURES else np.nan
        cages, figures = cages.copy(), FrameFigures(**columns)
        cages[gaps] = np.nan
    return SolvedBlock(block.start, cages, figures, squares.sum(axis=0), digests, faults)


def packed(block: SolvedBlock) -> bytes:
    """The bytes of a block."""
    faults = json.dumps({str(k): text for k, text in block.faults.items()}).encode()
    columns = [_kind(name, getattr(block.figures, name)) for name in FIGURES]
    return b"".join(
        [
            _COUNTS.pack(block.start, len(block.cages), len(faults)),
            *block.digests,
            np.ascontiguousarray(block.cages, "<f8").tobytes(),
            *(column.tobytes() for column in columns),
            np.ascontiguousarray(block.squares, "<f8").tobytes(),
            faults,
        ]
    )


def unpacked(data: bytes, vertices: int, cage_vertices: int) -> SolvedBlock:
    """The block whose bytes `data` are."""
    stream = io.BytesIO(data)
    start, count, length = _COUNTS.unpack(stream.read(_COUNTS.size))
    digests = tuple(stream.read(DIGEST_BYTES) for _ in range(count))
    cages = np.frombuffer(stream.read(24 * count * cage_vertices), "<f8")
    columns = {
        name: np.frombuffer(stream.read(8 * count), _kind(name, np.empty(0)).dtype)
        for name in FIGURES
    }
    squares = np.frombuffer(stream.read(8 * vertices), "<f8")
    faults = {int(k): text for k, text in json.loads(stream.read(length)).items()}
    cages = cages.reshape(count, cage_vertices, 3)
    return SolvedBlock(start, cages, FrameFigures(**columns), squares, digests, faults)


def _kind(name: str, column: np.ndarray) -> np.ndarray:
    return column.astype("<i8" if name in WHOLE_FIGURES else "<f8")
