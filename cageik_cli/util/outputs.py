"""Outputs: written under a temporary name, and renamed when they are complete.

A run that fails or is killed leaves what was there before.

Those that killed runs have left are found by their names. The name of an unfinished output holds
the process that writes it, so that a later run can tell whether that is still alive. Those of other
machines are left alone.
"""

import io
import os
import platform
import re
import shutil
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cageik_cli.util.errors import OutputError, make_write_error
from cageik_cli.util.files import Mark, exchange, mark_file, repeat_if_interrupted
from cageik_cli.util.messages import say


def check_writable(path: Path, overwrite: bool) -> None:
    """Refuse, before any work, an output that exists or cannot be written."""
    if path.is_dir():
        raise OutputError(f"{path}: is a folder, expected the name of a file to write")
    if path.exists() and not path.is_file():
        raise OutputError(f"{path}: is not a plain file, expected the name of a file to write")
    if path.exists() and not overwrite:
        raise _make_exists_error(path)
    _check_folder_exists(path)
    clear_leftovers(path)
    partial = make_unfinished_path(path)
    with _convert_os_errors(path):
        partial.touch(exist_ok=False)
        partial.unlink()


def check_folder_writable(
    path: Path, overwrite: bool, is_output_name: Callable[[str], bool]
) -> None:
    """Refuse, before any work, a folder of files that exists or cannot be written.

    It will hold the files that are written and no others. `is_output_name` says whether a file of a
    name is one of those; a folder that holds any other is never replaced.
    """
    place, here = path.resolve(), Path.cwd()
    clear_leftovers(place)
    if place == here or place in here.parents:
        raise OutputError(
            f"{path}: is the current folder or one above it; name a new folder, such as frames"
        )
    if place.exists() and not place.is_dir():
        raise OutputError(f"{path}: is a file, expected the name of a folder to write")
    with _convert_os_errors(path):
        entries = sorted(place.iterdir()) if place.exists() else []
    for entry in entries:
        if entry.is_symlink() or not entry.is_file() or not is_output_name(entry.name):
            raise OutputError(
                f"{path}: holds {entry.name}, which is none of the files to be written; "
                "choose a new or an empty folder"
            )
    if entries and not overwrite:
        raise _make_exists_error(path)
    _check_folder_exists(path)
    partial = make_unfinished_path(place)
    with _convert_os_errors(path):
        partial.mkdir()
        partial.rmdir()


def _make_exists_error(path: Path) -> OutputError:
    return OutputError(
        f"{path}: exists already; "
        + say("choose another name, or replace it with `overwrite=True`")
    )


def _check_folder_exists(path: Path) -> None:
    """Refuse the output `path` if the folder that it is in does not exist, as it is spelt."""
    if not path.parent.is_dir():
        raise OutputError(f"{path}: the folder {path.parent} does not exist; create it first")


def make_folder(folder: Path) -> None:
    """Create a folder, and those above it, unless it exists."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be created ({error.strerror or error})") from error


def check_no_overlap(outputs: Sequence[Path | None], inputs: Sequence[Path | None]) -> None:
    """Refuse an output that is an input or another output, or a folder that holds one.

    `-`, standard output, overlaps with nothing.
    """
    taken = {path.resolve() for path in inputs if path is not None}
    # Frames lie in few folders, whose parents are looked for once.
    above = {folder for held in {path.parent for path in taken} for folder in (held, *held.parents)}
    for path in outputs:
        if path is None or str(path) == "-":
            continue
        place = path.resolve()
        if not taken.isdisjoint([place, *place.parents]):
            raise OutputError(
                f"{path}: is read or written by this command already; choose another name"
            )
        if place in above:
            raise OutputError(
                f"{path}: is a folder with files that this command reads or writes; choose another"
            )
        taken.add(place)
        above.update(place.parents)


class DeferredErrorFile(io.FileIO):
    """A new binary file whose write errors are raised later, by `raise_deferred_error`.

    HDF5 does not survive a failed write: it fails again while it cleans up, prints messages, and
    may crash. Here every write seems to succeed. After one that failed nothing can be read back:
    HDF5 would take for data what happens to be in the memory that is not filled.
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

    def readinto(self, buffer: Any) -> int:
        """Fill `buffer` with bytes of the file, unless a write has failed."""
        self.raise_deferred_error()
        return super().readinto(buffer) or 0

    def truncate(self, size: int | None = None) -> int:
        """Set the size."""
        set_once = super().truncate
        try:
            return repeat_if_interrupted(lambda: set_once(size))
        except OSError as error:
            self._failure = self._failure or error
            return size or 0

    def raise_deferred_error(self) -> None:
        """Raise the first OSError of a write, if there was one."""
        if self._failure is not None:
            raise self._failure


@contextmanager
def atomic_file(
    path: Path, overwrite: bool, temporary_path: Path | None = None
) -> Iterator[DeferredErrorFile]:
    """Open a new file that is renamed to `path` if the block ends without an error.

    Until then it has a unique name, or `temporary_path` when no other run can use that; what a
    killed run left there is deleted.

    Raises
    ------
    OutputError
        When it cannot be written, or another run has written `path` meanwhile.
    """
    partial = temporary_path or make_unfinished_path(path)
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
    """Close the file when the block ends; its own first error is raised instead of the block's."""
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
    """Yield a temporary name with the suffix of `path`; the file there is renamed to `path`.

    For libraries that write files by name. The file is deleted if the block fails.
    """
    partial = make_unfinished_path(path, path.suffix)
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
    """Create a folder that is renamed to `path` if the block ends without an error."""
    place = path.resolve()
    partial = make_unfinished_path(place)
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


_MARKS: ContextVar[Mapping[Path, Mark | None]] = ContextVar("marks", default=MappingProxyType({}))


@contextmanager
def replace_only(marks: Mapping[Path, Mark | None]) -> Iterator[None]:
    """Replace files, while the block runs, only if they are still as they were marked.

    Files at other paths than those of `marks` are replaced as ever.
    """
    token = _MARKS.set(marks)
    try:
        yield
    finally:
        _MARKS.reset(token)


def _rename_into_place(path: Path, new: Path, overwrite: bool) -> None:
    """Rename the file `new` to `path`."""
    marks = _MARKS.get()
    is_other = path in marks and mark_file(path) != marks[path]
    if path.exists() and (is_other or not overwrite):
        raise OutputError(f"{path}: another run has written it meanwhile; choose another name")
    new.replace(path)


def _replace_folder(place: Path, new: Path) -> None:
    """Rename the folder `new` to `place`; a folder of that name, which holds only files, goes."""
    if not place.exists():
        new.rename(place)
        return
    old = new
    if not exchange(new, place):
        # A run that is killed between these two leaves a folder that the next run puts back.
        old = make_displaced_path(place)
        place.rename(old)
        try:
            new.rename(place)
        except BaseException:
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
    """Turn errors of the system inside into one that names the output `path`."""
    try:
        yield
    except OSError as error:
        raise make_write_error(path, error) from error


def write_text(path: Path, text: str, overwrite: bool) -> None:
    """Write a text file, completely or not at all."""
    write_bytes(path, text.encode(), overwrite)


def write_bytes(path: Path, data: bytes, overwrite: bool) -> None:
    """Write a file, completely or not at all."""
    check_writable(path, overwrite)
    with atomic_file(path, overwrite) as file:
        file.write(data)


Listener = Callable[[str], None]


_LISTENER: ContextVar[Listener | None] = ContextVar("listener", default=None)


_TOKEN = r"([0-9a-f]{8})([0-9a-f]{8})[0-9a-f]{8}"
"""Machine, process, and a random number."""


def make_unfinished_path(path: Path, suffix: str = "") -> Path:
    """Return a name for an unfinished output beside `path`, which no other run has.

    It ends in the suffix of `path` if that is given as `suffix`.
    """
    stem = path.name.removesuffix(suffix) if suffix else path.name
    token = f"{_identify_machine():08x}{os.getpid() & 0xFFFFFFFF:08x}{os.urandom(4).hex()}"
    return path.with_name(f"{stem}.{token}.partial{suffix}")


def make_displaced_path(path: Path) -> Path:
    """Return a name for the folder that an output replaces, until that has its place."""
    return make_unfinished_path(path).with_suffix(".replaced")


@contextmanager
def listen_to_leftovers(listener: Listener) -> Iterator[None]:
    """Pass a sentence on what is removed in the block to a listener."""
    token = _LISTENER.set(listener)
    try:
        yield
    finally:
        _LISTENER.reset(token)


def clear_leftovers(path: Path) -> None:
    """Remove what killed runs to the same output left, and put back a folder they displaced.

    Errors are ignored: the output itself can be written all the same.
    """
    with suppress(OSError):
        left = [file for file in path.parent.iterdir() if _is_left_over(file.name, path)]
        for file in sorted(left):
            is_folder = file.is_dir() and not file.is_symlink()
            # What is no folder was not displaced by a run, and would be written through.
            if file.name.endswith(".replaced") and is_folder and not os.path.lexists(path):
                file.rename(path)
                sentence = f"{path}: put back, as it was before a run that was killed"
            else:
                shutil.rmtree(file) if is_folder else file.unlink()
                sentence = f"{file}: removed, a run that was killed had left it"
            listener = _LISTENER.get()
            if listener is not None:
                listener(sentence)


def _is_left_over(name: str, path: Path) -> bool:
    """Tell whether a name is that of an unfinished output of a process that is dead."""
    if not name.startswith(f"{path.stem}."):
        return False
    ends = rf"(?:\.partial|\.replaced|\.partial{re.escape(path.suffix)}(?:\.\w+)?|\.partial\.\w+)"
    found = re.fullmatch(
        rf"(?:{re.escape(path.name)}|{re.escape(path.stem)})\.{_TOKEN}{ends}", name
    )
    if found is None or int(found[1], 16) != _identify_machine():
        return False
    return not _is_alive(int(found[2], 16))


def _is_alive(process: int) -> bool:
    if os.name != "posix":
        return True  # there is no safe way to ask: os.kill would end it
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True


@cache
def _identify_machine() -> int:
    """Return a number of this machine, and of the container, in which processes are counted."""
    known = [platform.node()]
    with suppress(OSError):
        known.append(Path("/etc/machine-id").read_text().strip())
    with suppress(OSError):
        known.append(os.readlink("/proc/self/ns/pid"))
    return zlib.crc32(" ".join(known).encode())
