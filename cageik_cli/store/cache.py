"""A folder of entries: what takes long to compute is kept under a key of all that it depends on.

An entry is a file that is named by its key. It is written beside its name and renamed, and its
digests are checked when it is read, so that neither a killed process nor a damaged disk can leave
an entry that is used. Any number of processes may use the folder at once. When an entry cannot be
read or written, a note says so and its content is computed.
"""

import os
import re
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

from cageik_cli.store.cache_entry import CorruptEntry, Entry, EntryFormat
from cageik_cli.util.files import open_locked, remove_locked
from cageik_cli.util.leftovers import clear_leftovers, make_unfinished_path

Value = TypeVar("Value")

LOCK_POLL_SECONDS = 0.05
"""Seconds between two checks whether another process has computed an entry."""

MAX_UNFINISHED_SECONDS = 3600.0
"""Seconds after which an unfinished file of any machine is taken for one of a killed process."""

_ENTRY_NAME = re.compile(r"[0-9a-f]{64}\.(weights|cage|fit)")
_PARTIAL_NAME = re.compile(r"[0-9a-f]{64}(\.\w+)+\.partial")


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
            self._remove_stale_lock(key)
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
