"""Files that one process at a time may write, as the operating system sees to it."""

import io
import os
import sys
from pathlib import Path

if sys.platform == "win32":
    import msvcrt

    def _is_mine(file: io.FileIO) -> bool:
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except PermissionError:
            return False
        return True

else:
    import fcntl

    def _is_mine(file: io.FileIO) -> bool:
        try:
            fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True


def open_locked(path: Path) -> io.FileIO | None:
    """Open a file to read and write, made if it is not there; None if another process has it.

    It is this process's alone until it is closed. Raises OSError when it cannot be opened.
    """
    while True:
        flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0)
        file = io.FileIO(os.open(path, flags, 0o666), "r+")
        if not _is_mine(file):
            file.close()
            return None
        # Who had it may have ended, and taken the name away, while it was opened here.
        if _has_name(file, path):
            return file
        file.close()


def remove_locked(path: Path, file: io.FileIO) -> None:
    """Close the file of `open_locked`, and delete it if it still has its name."""
    is_there = _has_name(file, path)
    if sys.platform == "win32":
        file.close()  # an open file cannot be deleted there
    if is_there:
        path.unlink()
    file.close()


def _has_name(file: io.FileIO, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False
