"""Vertex weights: one number per vertex, in a text file or a numpy array."""

import io
from pathlib import Path
from tokenize import TokenError

import numpy as np

from cageik_cli.formats.base.file_data import describe_source
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FormatError, error_context
from cageik_cli.util.input_files import read_input

_READ_ERRORS = (FormatError, ValueError, TypeError, EOFError, MemoryError, SyntaxError, TokenError)


def load_vertex_weights(path: Path) -> tuple[Floats, dict[str, str]]:
    """Read weights from `.npy`, or from text with one number per line; also name and digest.

    Raises
    ------
    InputError
        Naming the file, when it cannot be read or is not a list of numbers.
    """
    with error_context(path):
        data = read_input(path)
        try:
            if path.suffix.lower() == ".npy":
                weights = np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
            else:
                weights = _parse_text(data)
            if weights.dtype.kind not in "fiub":
                raise FormatError(f"it holds {weights.dtype} values")
        except _READ_ERRORS as error:
            # What libraries say quotes the file, which may be any that a file of options names.
            said = f" ({error})" if isinstance(error, FormatError) else ""
            raise FormatError(
                f"is not a list of numbers{said}; expected one per line, or a .npy array"
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
