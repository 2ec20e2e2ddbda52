"""Vertex weights: one number per vertex, in a text file or a numpy array."""

import io
from pathlib import Path
from tokenize import TokenError

import numpy as np

from cageik_cli.formats.base.file_data import describe_source
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FormatError, error_context
from cageik_cli.util.input_files import read_input


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
                words = data.decode().replace("_", "?").split()  # 1_0 is Python's, not a file's
                weights = np.array([float(word) for word in words])
            if weights.dtype.kind not in "fiub":
                raise ValueError(f"it holds {weights.dtype} values")
        except (ValueError, TypeError, EOFError, MemoryError, SyntaxError, TokenError) as error:
            raise FormatError(
                f"is not a list of numbers ({error}); expected one per line, or a .npy array"
            ) from error
        with np.errstate(over="ignore", invalid="ignore"):  # infinite weights are refused later
            return np.asarray(weights, dtype=np.float64), describe_source(path, data)
