"""Arrays that are in memory if they fit, and else in a temporary file."""

import os
import tempfile

import numpy as np

from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FileAccessError


def allocate_floats(count: int, memory: int) -> Floats:
    """Return room for numbers: in memory if they fit in so many bytes, else in a temporary file.

    Raises
    ------
    FileAccessError
        When the disk has no room for them.
    """
    size = 8 * count
    if size <= memory:
        return np.empty(count)
    folder = tempfile.gettempdir()
    try:
        with tempfile.TemporaryFile(dir=folder) as file:  # it is kept as long as it is mapped
            # Without room behind it, writing to a mapped file would end the process.
            _reserve(file.fileno(), size)
            return np.memmap(file, np.float64, "r+", shape=(count,))
    except OSError as error:
        raise FileAccessError(
            f"{folder}: cannot hold {size >> 20} MiB in a temporary file "
            f"({error.strerror or error}); set TMPDIR to another folder, or raise --memory"
        ) from error


def _reserve(descriptor: int, size: int) -> None:
    """Make a file of so many bytes that are on the disk."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(descriptor, 0, size)
        return
    zeros = bytes(1 << 20)
    for start in range(0, size, len(zeros)):
        os.write(descriptor, zeros[: size - start])
