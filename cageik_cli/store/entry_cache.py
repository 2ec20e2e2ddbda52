"""A folder of entries: what takes long to compute is kept under a key of all that it depends on.

An entry is a file that is named by its key. It is written beside its name and renamed, and its
digests are checked when it is read, so that neither a killed process nor a damaged disk can leave
an entry that is used. Any number of processes may use the folder at once. When an entry cannot be
read or written, a note says so and its content is computed.

Entries are not HDF5 files: read through HDF5, a hit takes 1.3 to 1.4 times as long.
"""

import hashlib
import json
import os
import re
import stat
import struct
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, BinaryIO, Generic, Protocol, TypeVar

import numpy as np

from cageik_cli.util.files import open_locked, remove_locked
from cageik_cli.util.leftovers import clear_leftovers, make_unfinished_path


class TimedEntry(Protocol):
    """A record of arrays and plain values."""

    @property
    def seconds(self) -> float:
        """Return the time that it took to compute."""


Entry = TypeVar("Entry", bound=TimedEntry)
Value = TypeVar("Value")

DEFAULT_MAX_BYTES = 2 << 30
"""Bytes that the entries of a folder may take; the least recently used are deleted."""

POLL_SECONDS = 0.05
"""Seconds between two checks whether another process has computed an entry."""

STALE_SECONDS = 3600.0
"""Seconds after which an unfinished file of any machine is taken for one of a killed process."""

_NEW_FILE = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
_DIGEST_BYTES = hashlib.sha256().digest_size
_ENTRY_NAME = re.compile(r"[0-9a-f]{64}\.(weights|cage|fit)")
_PARTIAL_NAME = re.compile(r"[0-9a-f]{64}(\.\w+)+\.partial")


class CorruptEntry(Exception):
    """A file under the name of an entry is not that entry, or not all of it."""


@dataclass(frozen=True, slots=True)
class EntryFormat(Generic[Entry]):
    """The entries of one kind.

    Attributes
    ----------
    name : str
        The suffix of their files, one of those that `_ENTRY_NAME` knows.
    subject : str
        What notes say of them: "the weights are".
    entry_type : type
        A dataclass; all of its fields but the arrays are plain values and tuples of them.
    arrays : mapping of str
        The names of its arrays, and their types in the file, in order.
    """

    name: str
    subject: str
    entry_type: type[Entry]
    arrays: Mapping[str, str]

    @property
    def magic(self) -> bytes:
        """Return the first bytes of a file."""
        return f"cageik {self.name} 1\n".encode()

    @property
    def field_names(self) -> list[str]:
        """Return the names of all fields of an entry."""
        return [field.name for field in fields(self.entry_type)]  # type: ignore[arg-type]  # a dataclass

    @property
    def file_start(self) -> struct.Struct:
        """Return the layout of what precedes the header: magic, digest and length of it."""
        return struct.Struct(f"<{len(self.magic)}s{_DIGEST_BYTES}sQ")


def pack_entry(entry_format: EntryFormat[Entry], key: str, entry: Entry) -> list[memoryview]:
    """Return the parts of an entry's file, in order."""
    values = {name: getattr(entry, name) for name in entry_format.field_names}
    arrays = [as_bytes(values[name], dtype) for name, dtype in entry_format.arrays.items()]
    shapes = {name: values[name].shape for name in entry_format.arrays}
    header = {"key": key, "digest": _compute_digest(arrays).hex(), **values, **shapes}
    text = json.dumps(header).encode()
    digest = _compute_digest([memoryview(text)])
    start = entry_format.file_start.pack(entry_format.magic, digest, len(text))
    return [memoryview(start + text), *arrays]


def read_entry(entry_format: EntryFormat[Entry], path: Path, key: str) -> Entry:
    """Read an entry and check its digests.

    Raises
    ------
    OSError
        When there is none, or it cannot be read.
    CorruptEntry
        When there is something else, or not all of it.
    """
    # Before it is opened: opening a pipe would wait for its writer.
    if not stat.S_ISREG(path.stat(follow_symlinks=False).st_mode):
        raise CorruptEntry("is not a plain file")
    with open(path, "rb") as file:
        header = _read_header(entry_format, file)
        if header.pop("key") != key:
            raise CorruptEntry("is the entry of another key")
        if set(header) != {"digest", *entry_format.field_names}:
            raise CorruptEntry("is the entry of another version of cageik")
        expected = bytes.fromhex(header.pop("digest"))
        arrays = {
            name: np.empty(header.pop(name), dtype) for name, dtype in entry_format.arrays.items()
        }
        parts = [as_bytes(array, array.dtype) for array in arrays.values()]
        whole = all(file.readinto(part) == len(part) for part in parts)
        if not whole or file.read(1) or _compute_digest(parts) != expected:
            raise CorruptEntry("is damaged")
    native = {
        name: array.astype(array.dtype.newbyteorder("="), copy=False)
        for name, array in arrays.items()
    }
    plain = {
        name: tuple(value) if isinstance(value, list) else value for name, value in header.items()
    }
    return entry_format.entry_type(**native, **plain)


def as_bytes(array: np.ndarray, dtype: "str | np.dtype[Any]") -> memoryview:
    """Return the numbers of an array, row by row, as bytes."""
    return np.ascontiguousarray(array, dtype).reshape(-1).view(np.uint8).data


def _read_header(entry_format: EntryFormat[Entry], file: BinaryIO) -> dict[str, Any]:
    """Read the header and check its digest, before the sizes in it are used."""
    layout = entry_format.file_start
    start = file.read(layout.size)
    if len(start) == layout.size:
        magic, expected, length = layout.unpack(start)
        if magic == entry_format.magic and length <= os.fstat(file.fileno()).st_size:
            text = file.read(length)
            if _compute_digest([memoryview(text)]) == expected:
                header: dict[str, Any] = json.loads(text)
                return header
    raise CorruptEntry("is damaged")


def _compute_digest(parts: list[memoryview]) -> bytes:
    """Return the SHA-256, for which processors have instructions: twice as fast as others."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.digest()


class EntryCache(Generic[Entry]):
    """A folder of entries of one kind; those of other kinds may be in it, too.

    Parameters
    ----------
    folder : Path
        Created with the first entry. Files in it that are not of a cache are left alone.
    note : callable
        Gets a sentence on what could not be read or written, and on what was saved.
    max_bytes : int
        Bytes that entries, of whatever kind, may take together.
    """

    def __init__(
        self,
        entry_format: EntryFormat[Entry],
        folder: Path,
        note: Callable[[str], None],
        max_bytes: int = DEFAULT_MAX_BYTES,
    ) -> None:
        self.folder, self.max_bytes = folder, max_bytes
        self._format, self._note = entry_format, note

    def find_or_compute(
        self,
        key: str,
        compute: Callable[[], Value],
        to_entry: Callable[[Value, float], Entry],
        from_entry: Callable[[Entry], Value],
    ) -> Value:
        """Return what `compute` gives, from the folder if it is there.

        Parameters
        ----------
        compute : callable
        to_entry : callable
            Makes the entry, of the value and the seconds that it took.
        from_entry : callable
            Makes the value of the entry.
        """
        entry = self._lookup(key)
        if entry is not None:
            self._remove_stale_lock(key)
        else:
            with self._entry_lock(key):
                entry = self._lookup(key)  # the process waited for has written it
                if entry is None:
                    start = time.perf_counter()
                    value = compute()
                    self.write(key, to_entry(value, time.perf_counter() - start))
                    return value
        return from_entry(entry)

    def _lookup(self, key: str) -> Entry | None:
        """Return the entry of a key, if it is there; a note says what that saved."""
        start = time.perf_counter()
        entry = self.read(key)
        if entry is not None:
            saved = max(0.0, entry.seconds - (time.perf_counter() - start))
            self._note(f"cache hit, saved {saved:.1f} s")
        return entry

    @contextmanager
    def _entry_lock(self, key: str) -> Iterator[None]:
        """Wait for the process that computes this entry, then keep others waiting.

        Without effect in a folder that cannot be written.
        """
        path = self._lock_path(key)
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            while (file := open_locked(path)) is None:
                time.sleep(POLL_SECONDS)
        except OSError:
            yield
            return
        try:
            yield
        finally:
            with suppress(OSError):  # the next process to use the entry deletes it
                remove_locked(path, file)

    def _remove_stale_lock(self, key: str) -> None:
        """Delete the lock of a process that was killed when it had written the entry."""
        path = self._lock_path(key)
        if os.path.lexists(path):
            with suppress(OSError):
                file = open_locked(path)
                if file is not None:
                    remove_locked(path, file)

    def _lock_path(self, key: str) -> Path:
        return self.folder / f"{key}.lock.partial"

    def read(self, key: str) -> Entry | None:
        """Return the entry of a key, if it is there; delete a damaged one, with a note."""
        path = self._entry_path(key)
        try:
            entry = read_entry(self._format, path, key)
        except OSError:
            # Not there, or not readable: then writing the entry notes why.
            return None
        except CorruptEntry as error:
            self._note(f"{path}: {error}; it is deleted and {self._format.subject} computed")
            with suppress(OSError):  # a folder stays: then writing the entry notes it
                path.unlink()
            return None
        with suppress(OSError):  # a read-only cache can be used, too
            os.utime(path)
        return entry

    def write(self, key: str, entry: Entry) -> None:
        """Keep an entry, and make room for it; a note says when it cannot be written."""
        parts = pack_entry(self._format, key, entry)
        size = sum(map(len, parts))
        if size > self.max_bytes:
            self._note(
                f"{self._format.subject} not kept ({size} bytes, the cache takes at most "
                f"{self.max_bytes})"
            )
            return
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._write_atomically(key, parts)
            self._evict_oldest()
        except OSError as error:
            reason = error.strerror or error
            self._note(
                f"{self.folder}: cannot be written ({reason}); {self._format.subject} not kept"
            )

    def _entry_path(self, key: str) -> Path:
        return self.folder / f"{key}.{self._format.name}"

    def _write_atomically(self, key: str, parts: list[memoryview]) -> None:
        """Write a file that only its owner may read beside the entry's name, and rename it.

        It is not flushed to disk: an entry that a power cut leaves in part fails its digest.
        """
        path = self._entry_path(key)
        clear_leftovers(path)
        partial = make_unfinished_path(path)
        descriptor = os.open(partial, _NEW_FILE, 0o600)
        try:
            with open(descriptor, "wb") as file:
                file.writelines(parts)
            partial.replace(path)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise

    def _evict_oldest(self) -> None:
        """Delete the least recently used entries until the rest fit, and old unfinished files.

        Other processes may do the same meanwhile, so a file may be gone already.
        """
        entries = sorted(
            (
                (status.st_mtime_ns, path, status.st_size)
                for path, status in self._list_files(_ENTRY_NAME)
            ),
            reverse=True,
        )
        taken = 0
        for _, path, size in entries:
            taken += size
            if taken > self.max_bytes:
                path.unlink(missing_ok=True)
        for path, status in self._list_files(_PARTIAL_NAME):
            if status.st_mtime < time.time() - STALE_SECONDS:
                path.unlink(missing_ok=True)

    def _list_files(self, name: re.Pattern[str]) -> list[tuple[Path, os.stat_result]]:
        found = []
        for path in self.folder.iterdir():
            if name.fullmatch(path.name):
                with suppress(FileNotFoundError):  # another process was faster
                    found.append((path, path.stat(follow_symlinks=False)))
        return [(path, status) for path, status in found if stat.S_ISREG(status.st_mode)]
