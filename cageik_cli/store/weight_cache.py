"""The weight cache: weights are kept under a key of all that they depend on.

An entry is a file that is named by its key. It is written beside its name and renamed, and its
digests are checked when it is read, so that neither a killed process nor a damaged disk can leave
an entry that is used. Any number of processes may use the folder at once. When an entry cannot be
read or written, a note says so and the weights are computed.

An entry is not a binding file: read through HDF5, a hit takes 1.3 to 1.4 times as long.
"""

import hashlib
import json
import os
import re
import stat
import struct
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from cageik_cli import __version__
from cageik_cli.coordinates.binding import ALGORITHM_VERSIONS, Binding
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.locks import open_locked, remove_locked

_MAGIC = b"cageik weights 1\n"
_DIGEST_BYTES = hashlib.sha256().digest_size
_FILE_START = struct.Struct(f"<{len(_MAGIC)}s{_DIGEST_BYTES}sQ")

DEFAULT_MAX_BYTES = 2 << 30
"""Bytes that the entries of a cache may take; the least recently used are deleted."""

POLL_SECONDS = 0.05
"""Seconds between two checks whether another process has computed an entry."""

STALE_SECONDS = 3600.0
"""Seconds after which an unfinished file is taken for one that a killed process left."""

_ENTRY_NAME = re.compile(r"[0-9a-f]{64}\.weights")
_PARTIAL_NAME = re.compile(r"[0-9a-f]{64}\.\w+\.partial")


class CorruptEntry(Exception):
    """A file under the name of an entry is not that entry, or not all of it."""


@dataclass(frozen=True, slots=True, eq=False)
class CacheEntry:
    """A binding without the arrays that its key stands for.

    Attributes
    ----------
    faces : (f, 3) int64
        Of the cage, outward.
    weights : (m, n) float64
    panels : int
    estimated_error : float
    projected : int
    notes, cage_warnings : tuple of str
        As in `Binding`.
    seconds : float
        The time that it took to compute.
    """

    faces: np.ndarray
    weights: np.ndarray
    panels: int
    estimated_error: float
    projected: int
    notes: tuple[str, ...]
    cage_warnings: tuple[str, ...]
    seconds: float


def pack_entry(key: str, entry: CacheEntry) -> list[memoryview]:
    """Return the parts of an entry's file, in order."""
    arrays = [as_bytes(entry.faces, "<i8"), as_bytes(entry.weights, "<f8")]
    header = {
        "key": key,
        "digest": _compute_digest(arrays).hex(),
        "faces": entry.faces.shape,
        "weights": entry.weights.shape,
        "panels": entry.panels,
        "estimated_error": entry.estimated_error,
        "projected": entry.projected,
        "notes": entry.notes,
        "cage_warnings": entry.cage_warnings,
        "seconds": entry.seconds,
    }
    text = json.dumps(header).encode()
    start = _FILE_START.pack(_MAGIC, _compute_digest([memoryview(text)]), len(text))
    return [memoryview(start + text), *arrays]


def read_entry(path: Path, key: str) -> CacheEntry:
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
        header = _read_header(file)
        if header.pop("key") != key:
            raise CorruptEntry("is the entry of another key")
        expected = bytes.fromhex(header.pop("digest"))
        faces = np.empty(header.pop("faces"), "<i8")
        weights = np.empty(header.pop("weights"), "<f8")
        parts = [as_bytes(faces, "<i8"), as_bytes(weights, "<f8")]
        whole = all(file.readinto(part) == len(part) for part in parts)
        if not whole or file.read(1) or _compute_digest(parts) != expected:
            raise CorruptEntry("is damaged")
    return CacheEntry(
        faces=faces.astype(np.int64, copy=False),
        weights=weights.astype(np.float64, copy=False),
        notes=tuple(header.pop("notes")),
        cage_warnings=tuple(header.pop("cage_warnings")),
        **header,
    )


def as_bytes(array: np.ndarray, dtype: str) -> memoryview:
    """Return the numbers of an array, row by row, as bytes."""
    return np.ascontiguousarray(array, dtype).reshape(-1).view(np.uint8).data


def _read_header(file: BinaryIO) -> dict[str, Any]:
    """Read the header and check its digest, before the sizes in it are used."""
    start = file.read(_FILE_START.size)
    if len(start) == _FILE_START.size:
        magic, expected, length = _FILE_START.unpack(start)
        if magic == _MAGIC and length <= os.fstat(file.fileno()).st_size:
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


class WeightCache:
    """A folder of entries.

    Parameters
    ----------
    folder : Path
        Created with the first entry. Files in it that are not of the cache are left alone.
    note : callable
        Told, in a sentence, what could not be read or written, and what was saved.
    max_bytes : int
        Bytes that entries may take together.
    """

    def __init__(
        self, folder: Path, note: Callable[[str], None], max_bytes: int = DEFAULT_MAX_BYTES
    ) -> None:
        self.folder, self.max_bytes = folder, max_bytes
        self._note = note

    def get_or_compute(
        self, rest: TriMesh, cage: TriMesh, settings: BindSettings, compute: Callable[[], Binding]
    ) -> Binding:
        """Return the binding that `compute` gives, from the cache if it is there."""
        key = compute_key(rest, cage, settings)
        entry = self._lookup(key)
        if entry is None:
            with self._entry_lock(key):
                entry = self._lookup(key)  # the process waited for has written it
                if entry is None:
                    start = time.perf_counter()
                    binding = compute()
                    self.write(key, _make_entry(binding, time.perf_counter() - start))
                    return binding
        return Binding(
            rest=rest,
            cage=TriMesh(cage.vertices, entry.faces),
            weights=entry.weights,
            settings=settings,
            panels=entry.panels,
            estimated_error=entry.estimated_error,
            projected=entry.projected,
            notes=entry.notes,
            cage_warnings=entry.cage_warnings,
        )

    def _lookup(self, key: str) -> CacheEntry | None:
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
        path = self.folder / f"{key}.lock.partial"
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
            remove_locked(path, file)

    def read(self, key: str) -> CacheEntry | None:
        """Return the entry of a key, if it is there; delete a damaged one, with a note."""
        path = self._entry_path(key)
        try:
            entry = read_entry(path, key)
        except OSError:
            # Not there, or not readable: then writing the entry notes why.
            return None
        except CorruptEntry as error:
            self._note(f"{path}: {error}; it is deleted and the weights are computed")
            with suppress(OSError):  # a folder stays: then writing the entry notes it
                path.unlink()
            return None
        with suppress(OSError):  # a read-only cache can be used, too
            os.utime(path)
        return entry

    def write(self, key: str, entry: CacheEntry) -> None:
        """Keep an entry, and make room for it; a note says when it cannot be written."""
        parts = pack_entry(key, entry)
        size = sum(map(len, parts))
        if size > self.max_bytes:
            self._note(
                f"the weights are not kept ({size} bytes, the cache takes at most {self.max_bytes})"
            )
            return
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._write_atomically(key, parts)
            self._evict_oldest()
        except OSError as error:
            reason = error.strerror or error
            self._note(f"{self.folder}: cannot be written ({reason}); the weights are not kept")

    def _entry_path(self, key: str) -> Path:
        return self.folder / f"{key}.weights"

    def _write_atomically(self, key: str, parts: list[memoryview]) -> None:
        """Write a file that only its owner may read beside the entry's name, and rename it.

        It is not flushed to disk: an entry that a power cut leaves in part fails its digest.
        """
        descriptor, name = tempfile.mkstemp(".partial", f"{key}.", self.folder)
        try:
            with open(descriptor, "wb") as file:
                file.writelines(parts)
            os.replace(name, self._entry_path(key))
        except BaseException:
            Path(name).unlink(missing_ok=True)
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


def compute_key(rest: TriMesh, cage: TriMesh, settings: BindSettings) -> str:
    """Return the key of a binding: a digest of all that its weights, notes and figures depend on.

    It covers the faces of the rest pose, on which warnings depend; not the number of threads, which
    does not change weights.
    """
    recorded = {
        "version": __version__,
        "algorithm": ALGORITHM_VERSIONS[settings.coordinates],
        **asdict(settings),
        "rest": len(rest.vertices),
        "cage": len(cage.vertices),
        "faces": [len(rest.faces), len(cage.faces)],
    }
    digest = hashlib.sha256(json.dumps(recorded, sort_keys=True).encode() + b"\n")
    for array in (rest.vertices, cage.vertices):
        digest.update(as_bytes(array, "<f8"))
    for faces in (rest.faces, cage.faces):
        digest.update(as_bytes(faces, "<i8"))
    return digest.hexdigest()


def _make_entry(binding: Binding, seconds: float) -> CacheEntry:
    return CacheEntry(
        faces=binding.cage.faces,
        weights=binding.weights,
        panels=binding.panels,
        estimated_error=binding.estimated_error,
        projected=binding.projected,
        notes=binding.notes,
        cage_warnings=binding.cage_warnings,
        seconds=seconds,
    )
