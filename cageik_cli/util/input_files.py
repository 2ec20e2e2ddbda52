"""Input files: opened as plain files only, and read within a limit of their size.

All files that a user names, and all that such files name, are opened here or checked here before a
library opens them. A pipe would keep the run waiting, and a device has no end.
"""

import io
import os
import stat
from pathlib import Path

from cageik_cli.util.errors import FileAccessError
from cageik_cli.util.text import format_bytes

MAX_FILE_BYTES = 1 << 30
"""Bytes of a file that is read as a whole: a mesh of more than ten million vertices, in text."""


def open_input(path: Path) -> io.FileIO:
    """Open a plain file for reading; links are followed to one.

    Raises
    ------
    FileAccessError
        When it is missing, cannot be read, or is a folder, a pipe or a device. The message does
        not name it.
    """
    flags = os.O_RDONLY
    for name in ("O_BINARY", "O_CLOEXEC", "O_NONBLOCK", "O_NOCTTY"):  # those that the system has
        flags |= getattr(os, name, 0)
    try:
        _check_plain(
            os.stat(path).st_mode
        )  # before it is opened, which can be a command to a device
        file = io.FileIO(os.open(path, flags), "rb")
    except OSError as error:
        raise FileAccessError(f"cannot be read: {error.strerror or error}") from error
    try:
        _check_plain(os.fstat(file.fileno()).st_mode)
    except BaseException:
        file.close()
        raise
    return file


def check_input(path: Path) -> None:
    """Refuse what `open_input` refuses, before a library opens the file by its name.

    Raises
    ------
    FileAccessError
        As `open_input` does.
    """
    open_input(path).close()


def read_input(
    path: Path, max_bytes: int = MAX_FILE_BYTES, expected: str = "a smaller file"
) -> bytes:
    """Read a whole file; the message on too large a one says to give what is `expected`.

    Raises
    ------
    FileAccessError
        As `open_input` does, or when the file has more than `max_bytes`.
    """
    with open_input(path) as file:
        try:
            size = os.fstat(file.fileno()).st_size
            data = b"" if size > max_bytes else _read_at_most(file, size, max_bytes + 1)
        except OSError as error:
            raise FileAccessError(f"cannot be read: {error.strerror or error}") from error
    found = max(size, len(data))
    if found > max_bytes:
        raise FileAccessError(
            f"has {format_bytes(found)}, expected at most {format_bytes(max_bytes)}; "
            f"give {expected}"
        )
    return data


def _read_at_most(file: io.FileIO, expected: int, limit: int) -> bytes:
    """Read until the end, or `limit` bytes: a file of the system may have more than it says."""
    parts, left = [], limit
    while left and (part := file.read(min(left, max(expected + 1, io.DEFAULT_BUFFER_SIZE)))):
        parts.append(part)
        left -= len(part)
    return b"".join(parts)


def _check_plain(mode: int) -> None:
    """Refuse what is not a plain file, by its mode."""
    if stat.S_ISDIR(mode):
        raise FileAccessError("is a folder, expected a file; give a file in it")
    if not stat.S_ISREG(mode):
        raise FileAccessError("is a pipe or a device, expected a plain file; copy its content")
