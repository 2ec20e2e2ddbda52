"""Vertex weights: one number per vertex, in a text file or a numpy array; or one row per frame."""

import io
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError

import numpy as np

from cageik_cli.formats.base.files import describe_source
from cageik_cli.formats.npz import FileArray, open_npy
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FileAccessError, FormatError, error_context
from cageik_cli.util.files import check_input, read_input

MAX_ROWS_BYTES = 1 << 22
"""Largest part of the weights of frames that is checked at once."""


@dataclass(frozen=True, slots=True)
class FrameWeightsFile:
    """Weights of the vertices of each frame, in a `.npy` file that is read frame by frame.

    Attributes
    ----------
    shape : tuple of int
        Frames and vertices.
    largest : float
        Of all weights in the file.
    mean_share : float
        The mean of those above 0, as the others are missing data, over the largest.
    """

    path: Path
    shape: tuple[int, ...]
    largest: float
    mean_share: float

    def read(self, start: int, stop: int) -> Floats:
        """Read the weights of frames `start` up to `stop`, exclusive: (k, m), from 0 to 1."""
        with error_context(self.path):
            array = open_npy(self.path)
            if array.shape != self.shape:
                raise FileAccessError("was written again after it was opened; run again")
            return np.asarray(array.read_rows(start, stop), np.float64) / self.largest


def open_frame_weights(path: Path, frames: int, vertices: int) -> FrameWeightsFile | None:
    """Open the weights of each frame of a clip; None for a file that is not an array (F, m)."""
    if path.suffix.lower() != ".npy":
        return None
    with error_context(path):
        check_input(path)
        try:
            array = open_npy(path)
        except FormatError:
            return None  # whoever reads one weight per vertex says what is wrong
        if len(array.shape) != 2:
            return None
        if array.shape != (frames, vertices):
            raise FormatError(
                f"weights of frames have shape {array.shape}, expected ({frames}, {vertices}): the "
                "frames that are taken and the vertices of the model"
            )
        if array.dtype.kind not in "fiub":
            raise FormatError(f"holds {array.dtype} values, expected numbers")
        return FrameWeightsFile(path, array.shape, *_check_rows(array))


def _check_rows(array: FileArray) -> tuple[float, float]:
    """Return the largest weight, and the mean of those above 0 over it; rows are read in parts."""
    rows, columns = array.shape
    size = max(1, MAX_ROWS_BYTES // (8 * columns))
    largest, total, count = 0.0, 0.0, 0
    for start in range(0, rows, size):
        with np.errstate(over="ignore", invalid="ignore"):  # what is infinite is refused
            part = np.asarray(array.read_rows(start, start + size), np.float64)
        is_wrong = ~(np.isfinite(part) & (part >= 0))
        if is_wrong.any():
            frame, vertex = np.argwhere(is_wrong)[0]
            raise FormatError(
                f"the weight of vertex {vertex} in row {start + frame} is {part[frame, vertex]}, "
                "expected a finite number of 0 or above"
            )
        most = float(part.max())
        if most > largest:
            total, largest = total * (largest / most), most
        if largest:
            total += float((part / largest).sum())  # a sum of large weights could overflow
        count += int(np.count_nonzero(part))
    if largest == 0:
        raise FormatError("all vertex weights are zero; expected at least one above 0")
    return largest, total / count


def read_vertex_weights(path: Path) -> tuple[Floats, dict[str, str]]:
    """Read weights from `.npy`, or from text with one number per line; also name and digest."""
    with error_context(path):
        data = read_input(path)
        try:
            if path.suffix.lower() == ".npy":
                weights = np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
            else:
                weights = _parse_text(data)
            if weights.dtype.kind not in "fiub":
                raise FormatError(f"it holds {weights.dtype} values")
        except (
            FormatError,
            ValueError,
            TypeError,
            EOFError,
            MemoryError,
            SyntaxError,
            TokenError,
        ) as error:
            # What libraries say quotes the file, which may be any that a file of options names.
            reason = f" ({error})" if isinstance(error, FormatError) else ""
            raise FormatError(
                f"is not a list of numbers{reason}; expected one per line, or a .npy array"
            ) from error
        with np.errstate(over="ignore", invalid="ignore"):  # infinite weights are refused later
            return np.asarray(weights, dtype=np.float64), describe_source(path, data)


def _parse_text(data: bytes) -> Floats:
    """Parse numbers with blanks between them; the message on a fault quotes nothing."""
    words = data.decode().replace("_", "?").split()  # 1_0 is Python's, not a file's
    numbers = np.empty(len(words))
    for k, word in enumerate(words):
        try:
            numbers[k] = float(word)
        except ValueError as error:
            raise FormatError(f"word {k + 1} is not a number") from error
    return numbers
