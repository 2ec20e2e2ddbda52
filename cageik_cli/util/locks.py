"""Locks on files: one process at a time writes a checkpoint, a cache entry, a batch's folder."""

import errno
import io
import os
import stat
import sys
from pathlib import Path

if sys.platform == "win32":
    import msvcrt

    def _try_lock(file: io.FileIO) -> bool:
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except PermissionError:
            return False
        return True

else:
    import fcntl

    def _try_lock(file: io.FileIO) -> bool:
        try:
            fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True


def open_locked(path: Path) -> io.FileIO | None:
    """Open and lock a file to read and write, created if absent; None if it is locked already.

    The lock is on the file itself and ends when the file is closed or the process dies. (The
    library filelock truncates the file that it locks, and hands out no open file.) Raises OSError
    when it cannot be opened, or is a link, a pipe or a device: who can write to the folder could
    have put it there, and would choose what is written over.
    """
    while True:
        file = _open_plain(path)
        if not _try_lock(file):
            file.close()
            return None
        # Its last owner may have deleted it after it was opened here.
        if _is_still_at(file, path):
            return file
        file.close()


def _open_plain(path: Path) -> io.FileIO:
    """Open a plain file to read and write, created if absent; links are not followed."""
    _refuse_special(path)
    flags = os.O_RDWR | os.O_CREAT
    for name in ("O_BINARY", "O_NOFOLLOW", "O_NONBLOCK", "O_NOCTTY"):  # as far as the system has it
        flags |= getattr(os, name, 0)
    file = io.FileIO(os.open(path, flags, 0o666), "r+")
    try:
        _refuse_special(file.fileno())
    except BaseException:
        file.close()
        raise
    return file


def _refuse_special(place: Path | int) -> None:
    """Raise OSError for anything but a plain file, by its path or its descriptor."""
    try:
        mode = os.lstat(place).st_mode if isinstance(place, Path) else os.fstat(place).st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISREG(mode):
        kind = "a link" if stat.S_ISLNK(mode) else "not a plain file"
        raise OSError(errno.ELOOP, f"it is {kind}; move it away")


def remove_locked(path: Path, file: io.FileIO) -> None:
    """Close the file of `open_locked`, and delete it if it still has its name."""
    is_there = _is_still_at(file, path)
    if sys.platform == "win32":
        file.close()  # an open file cannot be deleted there
    if is_there:
        path.unlink()
    file.close()


def _is_still_at(file: io.FileIO, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.lstat())
    except FileNotFoundError:
        return False
