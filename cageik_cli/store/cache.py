"""A folder of entries: what takes long to compute is kept under a key of all that it depends on.

An entry is a file that is named by its key. It is written beside its name and renamed, and its
digests are checked when it is read, so that neither a killed process nor a damaged disk can leave
an entry that is used. Any number of processes may use the folder at once. When an entry cannot be
read or written, a note says so and its content is computed.

Its file holds arrays and plain values behind digests. It is not an HDF5 file: read through HDF5, a
hit takes 1.3 to 1.4 times as long.
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
from dataclasses import dataclass
from io import BufferedReader
from math import prod
from pathlib import Path
from types import UnionType
from typing import Any, BinaryIO, TypeVar

import numpy as np
from numpy.typing import NDArray

from cageik_cli.util.files import open_locked, remove_locked
from cageik_cli.util.outputs import clear_leftovers, make_unfinished_path

Value = TypeVar("Value")


LOCK_POLL_SECONDS = 0.05
"""Seconds between two checks whether another process has computed an entry."""

MAX_UNFINISHED_SECONDS = 3600.0
"""Seconds after which an unfinished file of any machine is taken for one of a killed process."""

_ENTRY_NAME = re.compile(r"[0-9a-f]{64}\.(weights|cage|fit)")


_PARTIAL_NAME = re.compile(r"[0-9a-f]{64}(\.\w+)+\.partial")


Entry = dict[str, Any]
"""The arrays and plain values of an entry, by name."""


class CorruptEntry(Exception):
    """A file under the name of an entry is not that entry, or not all of it."""


@dataclass(frozen=True, slots=True)
class EntryFormat:
    """The entries of one kind.

    Attributes
    ----------
    name : str
        The suffix of their files, one of those that `_ENTRY_NAME` knows.
    subject : str
        What notes say of them: "the weights are".
    arrays : mapping of str
        The names of its arrays, and their types in the file, in order.
    values : mapping of type
        The names of its plain values and tuples of texts, and their types.
    """

    name: str
    subject: str
    arrays: Mapping[str, str]
    values: Mapping[str, type | UnionType]

    @property
    def magic(self) -> bytes:
        """Return the first bytes of a file."""
        return f"cageik {self.name} 2\n".encode()

    @property
    def file_start(self) -> struct.Struct:
        """Return the layout of what precedes the header: magic, digest and length of it."""
        return struct.Struct(f"<{len(self.magic)}s{hashlib.sha256().digest_size}sQ")

    def pack(self, key: str, entry: Entry) -> list[memoryview]:
        """Return the parts of an entry's file, in order; `seconds` is among its values."""
        arrays = [_as_bytes(entry[name], dtype) for name, dtype in self.arrays.items()]
        shapes = {name: entry[name].shape for name in self.arrays}
        values = {name: entry[name] for name in ("seconds", *self.values)}
        header = {"key": key, "digest": _compute_digest(arrays).hex(), **values, **shapes}
        text = json.dumps(header).encode()
        digest = _compute_digest([memoryview(text)])
        return [memoryview(self.file_start.pack(self.magic, digest, len(text)) + text), *arrays]

    def read(self, path: Path, key: str) -> Entry:
        """Read an entry and check its digests.

        Raises
        ------
        OSError
            When there is none, or it cannot be read.
        CorruptEntry
            When there is something else, or not all of it.
        """
        try:
            return self._parse(path, key)
        except (OSError, CorruptEntry):
            raise
        except Exception as error:  # whatever a wrong header makes of its values
            raise CorruptEntry("is damaged") from error

    def _parse(self, path: Path, key: str) -> Entry:
        """Read an entry, or raise what a digest does not keep a wrong header from raising."""
        # Before it is opened: opening a pipe would wait for its writer.
        if not stat.S_ISREG(path.stat(follow_symlinks=False).st_mode):
            raise CorruptEntry("is not a plain file")
        with open(path, "rb") as file:
            header = self._read_header(file)
            if header.pop("key") != key:
                raise CorruptEntry("is the entry of another key")
            if set(header) != {"digest", "seconds", *self.arrays, *self.values}:
                raise CorruptEntry("is the entry of another version of cageik")
            arrays = self._read_arrays(file, header)
        plain = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in header.items()
        }
        for name, kind in {"seconds": float, **self.values}.items():
            if not isinstance(plain[name], kind):
                raise CorruptEntry("is damaged")
        return arrays | plain

    def _read_arrays(self, file: BufferedReader, header: dict[str, Any]) -> dict[str, NDArray[Any]]:
        """Read the arrays behind the header, whose fields on them are taken out of it."""
        expected = bytes.fromhex(header.pop("digest"))
        shapes = [(header.pop(name), np.dtype(kind)) for name, kind in self.arrays.items()]
        size = sum(prod(shape) * kind.itemsize for shape, kind in shapes)
        if size != os.fstat(file.fileno()).st_size - file.tell():
            raise CorruptEntry("is damaged")  # before so much memory is taken
        arrays = [np.empty(shape, kind) for shape, kind in shapes]
        parts = [_as_bytes(array, array.dtype) for array in arrays]
        whole = all(file.readinto(part) == len(part) for part in parts)
        if not whole or file.read(1) or _compute_digest(parts) != expected:
            raise CorruptEntry("is damaged")
        native = (array.astype(array.dtype.newbyteorder("="), copy=False) for array in arrays)
        return dict(zip(self.arrays, native, strict=True))

    def _read_header(self, file: BinaryIO) -> dict[str, Any]:
        """Read the header and check its digest, before the sizes in it are used."""
        start = file.read(self.file_start.size)
        if len(start) == self.file_start.size:
            magic, expected, length = self.file_start.unpack(start)
            if magic == self.magic and length <= os.fstat(file.fileno()).st_size:
                text = file.read(length)
                if _compute_digest([memoryview(text)]) == expected:
                    header: dict[str, Any] = json.loads(text)
                    return header
        raise CorruptEntry("is damaged")


class EntryCache:
    """A folder of entries of all kinds.

    Parameters
    ----------
    folder : Path
        Created with the first entry. Files in it that are not of a cache are left alone.
    note : callable
        Gets a sentence on what could not be read or written, and on what was saved.
    max_bytes : int
        Bytes that entries, of whatever kind, may take together; the least recently used are
        deleted.
    """

    def __init__(
        self,
        folder: Path,
        note: Callable[[str], None],
        max_bytes: int = 2 << 30,
    ) -> None:
        self.folder, self.max_bytes, self._note = folder, max_bytes, note

    def find_or_compute(
        self,
        kind: EntryFormat,
        key: str,
        compute: Callable[[], Value],
        to_entry: Callable[[Value], Entry],
        from_entry: Callable[[Entry], Value],
    ) -> Value:
        """Return what `compute` gives, from the folder if it is there.

        `to_entry` makes the entry of the value, and `from_entry` the value of the entry.
        """
        value = self._lookup(kind, key, from_entry)
        if value is not None:
            path = self._lock_path(key)
            if os.path.lexists(path):  # of a process that was killed when it had written the entry
                with suppress(OSError):
                    file = open_locked(path)
                    if file is not None:
                        remove_locked(path, file)
            return value
        with self._entry_lock(key):
            value = self._lookup(kind, key, from_entry)  # the process waited for has written it
            if value is None:
                start = time.perf_counter()
                value = compute()
                self.write(kind, key, to_entry(value), time.perf_counter() - start)
            return value

    def _lookup(
        self, kind: EntryFormat, key: str, from_entry: Callable[[Entry], Value]
    ) -> Value | None:
        """Return the value of a key, if it is there; a note says what that saved."""
        start = time.perf_counter()
        entry = self.read(kind, key)
        if entry is None:
            return None
        seconds = entry.pop("seconds")
        try:
            value = from_entry(entry)
        except Exception:  # whatever wrong values of a header lead to
            self._discard(kind, key, CorruptEntry("is damaged"))
            return None
        saved = max(0.0, seconds - (time.perf_counter() - start))
        self._note(f"cache hit, saved {saved:.1f} s")
        return value

    def _discard(self, kind: EntryFormat, key: str, fault: CorruptEntry) -> None:
        """Delete an entry that cannot be used, with a note."""
        path = self._entry_path(kind, key)
        self._note(f"{path}: {fault}; it is deleted and {kind.subject} computed")
        with suppress(OSError):  # a folder stays: then writing the entry notes it
            path.unlink()

    @contextmanager
    def _entry_lock(self, key: str) -> Iterator[None]:
        """Wait for the process that computes this entry, then keep others waiting.

        Without effect in a folder that cannot be written.
        """
        path = self._lock_path(key)
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            while (file := open_locked(path)) is None:
                time.sleep(LOCK_POLL_SECONDS)
        except OSError:
            yield
            return
        try:
            yield
        finally:
            with suppress(OSError):  # the next process to use the entry deletes it
                remove_locked(path, file)

    def _lock_path(self, key: str) -> Path:
        return self.folder / f"{key}.lock.partial"

    def read(self, kind: EntryFormat, key: str) -> Entry | None:
        """Return the entry of a key, if it is there; delete a damaged one, with a note."""
        path = self._entry_path(kind, key)
        try:
            entry = kind.read(path, key)
        except OSError:
            # Not there, or not readable: then writing the entry notes why.
            return None
        except CorruptEntry as error:
            self._discard(kind, key, error)
            return None
        with suppress(OSError):  # a read-only cache can be used, too
            os.utime(path)
        return entry

    def write(self, kind: EntryFormat, key: str, entry: Entry, seconds: float) -> None:
        """Keep an entry that took so long; a note says when it cannot be written."""
        parts = kind.pack(key, entry | {"seconds": seconds})
        size = sum(map(len, parts))
        if size > self.max_bytes:
            self._note(
                f"{kind.subject} not kept ({size} bytes, the cache takes at most {self.max_bytes})"
            )
            return
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._write_atomically(self._entry_path(kind, key), parts)
            self._evict_oldest()
        except OSError as error:
            reason = error.strerror or error
            self._note(f"{self.folder}: cannot be written ({reason}); {kind.subject} not kept")

    def _entry_path(self, kind: EntryFormat, key: str) -> Path:
        return self.folder / f"{key}.{kind.name}"

    def _write_atomically(self, path: Path, parts: list[memoryview]) -> None:
        """Write a file that only its owner may read beside the entry's name, and rename it.

        It is not flushed to disk: an entry that a power cut leaves in part fails its digest.
        """
        clear_leftovers(path)
        partial = make_unfinished_path(path)
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
        descriptor = os.open(partial, flags, 0o600)
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
            if status.st_mtime < time.time() - MAX_UNFINISHED_SECONDS:
                path.unlink(missing_ok=True)

    def _list_files(self, name: re.Pattern[str]) -> list[tuple[Path, os.stat_result]]:
        found = []
        for path in self.folder.iterdir():
            if name.fullmatch(path.name):
                with suppress(FileNotFoundError):  # another process was faster
                    found.append((path, path.stat(follow_symlinks=False)))
        return [(path, status) for path, status in found if stat.S_ISREG(status.st_mode)]


def compute_key(values: Mapping[str, Any], *arrays: np.ndarray) -> str:
    """Return a digest of all that something depends on, as 64 hexadecimal digits.

    Parameters
    ----------
    values : mapping
        Plain values, by name.
    arrays
        Their types, shapes and numbers count, not how they lie in memory.
    """
    recorded = [values, *((array.dtype.str, array.shape) for array in arrays)]
    parts = [memoryview(json.dumps(recorded, sort_keys=True).encode())]
    return _compute_digest([*parts, *(_as_bytes(array, array.dtype) for array in arrays)]).hex()


def _as_bytes(array: np.ndarray, dtype: "str | np.dtype[Any]") -> memoryview:
    """Return the numbers of an array, row by row, as bytes."""
    return np.ascontiguousarray(array, dtype).reshape(-1).view(np.uint8).data


def _compute_digest(parts: list[memoryview]) -> bytes:
    """Return the SHA-256, for which processors have instructions: twice as fast as others."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.digest()
