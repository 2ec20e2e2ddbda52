"""Outputs are written beside their names and take them when whole; nothing else is touched."""

import io
import os
import secrets
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cageik_cli.util.errors import InputError


def check_writable(path: Path, overwrite: bool) -> None:
    """Refuse, before any work, an output that exists or cannot be written.

    Raises
    ------
    InputError
        Naming the output and what to do.
    """
    if path.is_dir():
        raise InputError(f"{path}: is a folder, expected the name of a file to write")
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is not a plain file, expected the name of a file to write")
    if path.exists() and not overwrite:
        raise InputError(
            f"{path}: exists already; choose another name, or replace it with --overwrite"
        )
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist; create it first")
    partial = _unique_path(path)
    try:
        partial.touch(exist_ok=False)
        partial.unlink()
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); choose another folder"
        ) from error


def check_folder_writable(
    path: Path, overwrite: bool, is_output_name: Callable[[str], bool]
) -> None:
    """Refuse, before any work, a folder of files that exists or cannot be written.

    Parameters
    ----------
    path : Path
        It is to hold what is written and nothing else.
    overwrite : bool
        Whether it may be replaced.
    is_output_name : callable
        Whether a file of this name is one of those to be written; a folder that holds another is
        not replaced in any case.

    Raises
    ------
    InputError
        Naming the folder and what to do.
    """
    place, here = path.resolve(), Path.cwd()
    if place == here or place in here.parents:
        raise InputError(
            f"{path}: is the folder of this command; name one for these files alone, such as frames"
        )
    if place.exists() and not place.is_dir():
        raise InputError(f"{path}: is a file, expected the name of a folder to write")
    with _convert_os_errors(path):
        entries = sorted(place.iterdir()) if place.exists() else []
    for entry in entries:
        if entry.is_symlink() or not entry.is_file() or not is_output_name(entry.name):
            raise InputError(
                f"{path}: holds {entry.name}, which is none of the files to be written; "
                "choose a folder for these alone"
            )
    if entries and not overwrite:
        raise InputError(
            f"{path}: exists already; choose another name, or replace it with --overwrite"
        )
    if not place.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist; create it first")
    partial = _unique_path(place)
    with _convert_os_errors(path):
        partial.mkdir()
        partial.rmdir()


def make_folder(folder: Path) -> None:
    """Make a folder, and those above it, if it is not there.

    Raises
    ------
    InputError
        When it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror or error})") from error


def check_no_overlap(outputs: Sequence[Path | None], inputs: Sequence[Path | None]) -> None:
    """Refuse an output that is an input, or another output, or a folder with one; `-` is neither.

    Raises
    ------
    InputError
        Naming the file that would be lost.
    """
    taken = {path.resolve() for path in inputs if path is not None}
    for path in outputs:
        if path is None or str(path) == "-":
            continue
        place = path.resolve()
        if not taken.isdisjoint([place, *place.parents]):
            raise InputError(f"{path}: is read or written by this command already; choose another")
        if any(place in other.parents for other in taken):
            raise InputError(
                f"{path}: is a folder with files that this command reads or writes; choose another"
            )
        taken.add(place)


class DeferredErrorFile(io.FileIO):
    """A new binary file that keeps the first failure to itself until it is asked for.

    HDF5 does not survive a write that fails: it fails again while it cleans up, aloud, and may
    crash. Here every write seems to succeed; `raise_deferred_error` raises what did not.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, "x+")
        self._failure: OSError | None = None

    def write(self, data: Any) -> int:
        """Write all of `data`."""
        view = memoryview(data).cast("B")
        done = 0
        try:
            while done < len(view) and self._failure is None:
                done += super().write(view[done:]) or 0
        except OSError as error:
            self._failure = error
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Set the size."""
        try:
            return super().truncate(size)
        except OSError as error:
            self._failure = self._failure or error
            return size or 0

    def raise_deferred_error(self) -> None:
        """Raise the OSError that a write met, if one did."""
        if self._failure is not None:
            raise self._failure


@contextmanager
def atomic_file(
    path: Path, overwrite: bool, temporary_path: Path | None = None
) -> Iterator[DeferredErrorFile]:
    """A file beside `path` that takes its name if the block ends without an error.

    It has a name of its own, or `temporary_path` when no other run can have that; what a killed
    run left there is deleted.

    Raises
    ------
    InputError
        When it cannot be written, or another file has come to have the name meanwhile.
    """
    partial = temporary_path or _unique_path(path)
    with _convert_os_errors(path):
        if temporary_path is not None:
            temporary_path.unlink(missing_ok=True)
        new = DeferredErrorFile(partial)
        try:
            with _flush_to_disk(new):
                yield new
            _rename_into_place(path, partial, overwrite)
        finally:
            partial.unlink(missing_ok=True)


@contextmanager
def _flush_to_disk(file: DeferredErrorFile) -> Iterator[None]:
    """Close the file when the block ends; its own first failure is raised before the block's."""
    with file:
        try:
            yield
        except Exception:
            file.raise_deferred_error()
            raise
        file.raise_deferred_error()
        os.fsync(file.fileno())


@contextmanager
def atomic_path(path: Path, overwrite: bool) -> Iterator[Path]:
    """A name beside `path`, of its suffix; what the block writes there takes the name of `path`.

    For libraries that write files by name. What is there is removed if the block fails.

    Raises
    ------
    InputError
        When it cannot be written, or another file has come to have the name meanwhile.
    """
    partial = path.with_name(f"{path.stem}.{secrets.token_hex(8)}.partial{path.suffix}")
    with _convert_os_errors(path):
        try:
            yield partial
            _fsync(partial)
            _rename_into_place(path, partial, overwrite)
        finally:
            partial.unlink(missing_ok=True)


@contextmanager
def atomic_folder(
    path: Path, overwrite: bool, is_output_name: Callable[[str], bool]
) -> Iterator[Path]:
    """A folder beside `path` that takes its name if the block ends without an error.

    Raises
    ------
    InputError
        When it cannot be written, or the folder of that name may not be replaced (any more).
    """
    place = path.resolve()
    partial = _unique_path(place)
    with _convert_os_errors(path):
        partial.mkdir()
        try:
            yield partial
            for file in partial.iterdir():
                _fsync(file)
            check_folder_writable(path, overwrite, is_output_name)
            _replace_folder(place, partial)
        finally:
            shutil.rmtree(partial, ignore_errors=True)


def _rename_into_place(path: Path, new: Path, overwrite: bool) -> None:
    """Let the file `new` be called `path`."""
    if path.exists() and not overwrite:
        raise InputError(f"{path}: another run has written it meanwhile; choose another")
    new.replace(path)


def _replace_folder(place: Path, new: Path) -> None:
    """Let `new` take the name of the folder `place`, if there is one, of nothing but files."""
    if not place.exists():
        new.rename(place)
        return
    old = _unique_path(place)
    place.rename(old)
    try:
        new.rename(place)
    except OSError:
        old.rename(place)
        raise
    for file in old.iterdir():
        file.unlink()
    old.rmdir()


def _fsync(path: Path) -> None:
    with path.open("rb") as stream:
        os.fsync(stream.fileno())


@contextmanager
def _convert_os_errors(path: Path) -> Iterator[None]:
    """Make of whatever the system refuses inside a sentence about the output `path`."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from error


def write_text(path: Path, text: str, overwrite: bool) -> None:
    """Write a text file, whole or not at all.

    Raises
    ------
    InputError
        When it exists and may not be replaced, or cannot be written.
    """
    write_bytes(path, text.encode(), overwrite)


def write_bytes(path: Path, data: bytes, overwrite: bool) -> None:
    """Write a file, whole or not at all.

    Raises
    ------
    InputError
        As `write_text` does.
    """
    check_writable(path, overwrite)
    with atomic_file(path, overwrite) as file:
        file.write(data)


def _unique_path(path: Path) -> Path:
    """A name beside `path` that no other run has, on whatever machine that shares the folder."""
    return path.with_name(f"{path.name}.{secrets.token_hex(8)}.partial")


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
    """Open a file to read and write, made if it is not there; None if another process has it.

    It is this process's alone until it is closed. Raises OSError when it cannot be opened.
    """
    while True:
        flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0)
        file = io.FileIO(os.open(path, flags, 0o666), "r+")
        if not _try_lock(file):
            file.close()
            return None
        # Who had it may have ended, and taken the name away, while it was opened here.
        if _is_still_at(file, path):
            return file
        file.close()


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
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False
