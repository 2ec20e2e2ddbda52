"""Files: opened as plain files only, read within a limit of their size, locked and exchanged.

All files that a user names, and all that such files name, are opened here or checked here before a
library opens them. A pipe would keep the run waiting, and a device has no end.

One process at a time holds the lock of a checkpoint, a cache entry or a batch's folder.
"""

import codecs
import errno
import io
import os
import re
import stat
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from cageik_cli.util.errors import FileAccessError, FormatError
from cageik_cli.util.text import format_bytes

Value = TypeVar("Value")

MAX_FILE_BYTES = 1 << 30
"""Bytes of a file that is read as a whole: a mesh of more than ten million vertices, in text."""

HEAD_BYTES = 1024
"""First bytes of a file, which tell whether it is what its name says."""

POINTERS = (
    (b"version https://git-lfs.github.com/spec/", "Git LFS", "git lfs pull"),
    (b"version https://hawser.github.com/spec/", "Git LFS", "git lfs pull"),
    (b"/annex/objects/", "git-annex", "git annex get"),
)
"""How files begin that stand for others, what makes them, and what gets the others."""

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
    except (FileNotFoundError, ValueError) as error:  # ValueError: its name has a null character
        raise FileAccessError("no such file; check the path") from error
    except OSError as error:
        raise FileAccessError(f"cannot be read: {error.strerror or error}") from error
    try:
        _check_plain(os.fstat(file.fileno()).st_mode)
    except BaseException:
        file.close()
        raise
    return file


Mark = tuple[int, ...]
"""What changes when a file is written or replaced."""


def mark_file(path: Path) -> Mark | None:
    """Return the mark of a file; None if there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def check_input(path: Path) -> None:
    """Refuse what `open_input` refuses, before a library opens the file by its name."""
    open_input(path).close()


def open_content(path: Path, *, is_json: bool = False, may_be_empty: bool = False) -> io.FileIO:
    """Open a plain file as `open_input` does, and refuse what `check_content` does."""
    file = open_input(path)
    try:
        check_content(file.read(HEAD_BYTES) or b"", is_json=is_json, may_be_empty=may_be_empty)
        file.seek(0)
    except OSError as error:
        file.close()
        raise FileAccessError(f"cannot be read: {error.strerror or error}") from error
    except BaseException:
        file.close()
        raise
    return file


def check_content(head: bytes, *, is_json: bool = False, may_be_empty: bool = False) -> None:
    """Refuse what came in place of a file, by its first bytes; nothing of it is quoted.

    Parameters
    ----------
    head : bytes
        The first `HEAD_BYTES` of the file, or all of a shorter one.
    is_json : bool
        Whether the file is one of JSON, which a server's message may be, too.

    Raises
    ------
    FormatError
        For an empty file, a pointer of Git LFS or git-annex, a web page, and XML or JSON, as
        servers send it when they refuse a download. The message does not name the file.
    """
    is_wide = head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))  # browsers save pages so
    text = head.decode("utf-16", "ignore").encode(errors="ignore") if is_wide else head
    text = text.removeprefix(codecs.BOM_UTF8).lstrip()
    if not head and not may_be_empty:
        raise FormatError("the file is empty; copy, download or export it again")
    for start, kind, command in POINTERS:
        if text.startswith(start):
            raise FormatError(f"is a pointer of {kind}, not the file itself; get it by `{command}`")
    if b"\0" in text:
        return
    again = "it may be what a server has sent in place of the file; download it again"
    if re.match(rb"<(!doctype html|html|head|body|script|title|meta)\b", text, re.IGNORECASE) or (
        re.match(rb"<[!?a-z]", text, re.IGNORECASE) and b"<html" in text.lower()
    ):
        raise FormatError(f"is a web page (HTML): {again}")
    if re.match(rb"<[?!a-z]", text, re.IGNORECASE):
        raise FormatError(f"is XML, such as a message of an error: {again}")
    if not is_json and re.match(rb'\{\s*("|\})', text):
        raise FormatError(f"is JSON, such as a message of an error: {again}")


def read_input(
    path: Path,
    max_bytes: int = MAX_FILE_BYTES,
    expected: str = "a smaller file",
    *,
    is_json: bool = False,
    may_be_empty: bool = False,
) -> bytes:
    """Read a whole file of at most `max_bytes`, as `open_content` opens it.

    The message on a larger one says to give what is `expected`.
    """
    with open_content(path, is_json=is_json, may_be_empty=may_be_empty) as file:
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


def exchange(one: Path, other: Path) -> bool:
    """Exchange the names of two files or folders in one step; False where that is not possible.

    Linux has it since 3.15 (`renameat2`), macOS since 10.12 (`renamex_np`), not for all kinds of
    disks.
    """
    import ctypes  # slow to import, and only for folders that are replaced

    names = os.fsencode(one), os.fsencode(other)
    current_folder, swap = -100, 2  # AT_FDCWD, and RENAME_EXCHANGE or RENAME_SWAP
    try:
        library = ctypes.CDLL(None, use_errno=True)
        if sys.platform == "darwin":
            return bool(library.renamex_np(*names, swap) == 0)
        first, second = ((current_folder, name) for name in names)
        return bool(library.renameat2(*first, *second, swap) == 0)
    except (OSError, AttributeError, TypeError):
        return False  # a system without it


def repeat_if_interrupted(call: Callable[[], Value]) -> Value:
    """Return what a call gives, made again as long as a signal interrupts it."""
    while True:
        try:
            return call()
        except InterruptedError:
            continue


def set_size(file: Any, size: int) -> None:
    """Set the size of an open binary file; Python gives up when a signal interrupts that."""
    repeat_if_interrupted(lambda: file.truncate(size))
