"""A cache of weights, keyed by all they depend on: nothing but time depends on what it holds.

An entry is a file, named by its key. It is written beside its name and renamed, and its digests are
compared when it is read, so that neither a process that is killed nor a disk that forgets can make
an entry that is taken for whole. Any number of processes may use the folder at once. What goes
wrong with it is remarked, and the weights are computed.
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
from cageik_cli.coordinates.binding import ALGORITHM_VERSIONS, Binding, BindSettings
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.outputs import open_locked, remove_locked

_MAGIC = b"cageik weights 1\n"
_DIGEST_BYTES = hashlib.sha256().digest_size
_FILE_START = struct.Struct(f"<{len(_MAGIC)}s{_DIGEST_BYTES}sQ")


class CorruptEntry(Exception):
    """What an entry's name leads to is not that entry, whole."""


@dataclass(frozen=True, slots=True, eq=False)
class CacheEntry:
    """What is kept of a binding, beside what its key stands for.

    Attributes
    ----------
    faces : (f, 3) int64
        Of the cage, outward.
    weights : (m, n) float64
    panels : int
    estimated_error : float
    projected : int
    notes : tuple of str
        As in `Binding`.
    seconds : float
        What it took to compute.
    """

    faces: np.ndarray
    weights: np.ndarray
    panels: int
    estimated_error: float
    projected: int
    notes: tuple[str, ...]
    seconds: float


def pack_entry(key: str, entry: CacheEntry) -> list[memoryview]:
    """The parts of an entry's file, one behind the other."""
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
        "seconds": entry.seconds,
    }
    text = json.dumps(header).encode()
    start = _FILE_START.pack(_MAGIC, _compute_digest([memoryview(text)]), len(text))
    return [memoryview(start + text), *arrays]


def read_entry(path: Path, key: str) -> CacheEntry:
    """Read an entry and compare its digests.

    Raises
    ------
    OSError
        When there is none, or it cannot be read.
    Unusable
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
        **header,
    )


def as_bytes(array: np.ndarray, dtype: str) -> memoryview:
    """The numbers of an array, row by row, as bytes."""
    return np.ascontiguousarray(array, dtype).reshape(-1).view(np.uint8).data


def _read_header(file: BinaryIO) -> dict[str, Any]:
    """The header as it was written, or none; only then is it believed how long the arrays are."""
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
    """SHA-256, for which processors have instructions: twice as fast as others."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.digest()


DEFAULT_MAX_BYTES = 2 << 30
"""Bytes that the entries of a cache may take; those used longest ago make room."""

POLL_SECONDS = 0.05
"""Seconds between two looks whether another process has computed an entry."""

STALE_SECONDS = 3600.0
"""Seconds after which a file that is still being written was left by a process that was killed."""

_ENTRY_NAME = re.compile(r"[0-9a-f]{64}\.weights")
_PARTIAL_NAME = re.compile(r"[0-9a-f]{64}\.\w+\.partial")


class WeightCache:
    """A folder of entries.

    Parameters
    ----------
    folder : Path
        Made when the first entry is computed. Files in it that are not of the cache are left alone.
    remark : callable
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
        """The binding that `compute` gives, from the cache if it is there."""
        key = compute_key(rest, cage, settings)
        entry = self._lookup(key)
        if entry is None:
            with self._entry_lock(key):
                entry = self._lookup(key)  # who was waited for has written it
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
        )

    def _lookup(self, key: str) -> CacheEntry | None:
        """The entry of a key, if it is there; what that saved is remarked."""
        start = time.perf_counter()
        entry = self.read(key)
        if entry is not None:
            saved = max(0.0, entry.seconds - (time.perf_counter() - start))
            self._note(f"weights taken from it, {saved:.1f} s saved")
        return entry

    @contextmanager
    def _entry_lock(self, key: str) -> Iterator[None]:
        """Wait for the process that computes this entry, and be it then.

        In a folder that cannot be written nobody waits.
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
        """The entry of a key, if it is there; one that is damaged is deleted, and remarked."""
        path = self._entry_path(key)
        try:
            entry = read_entry(path, key)
        except OSError:
            # Not there, or out of reach, which is remarked when the entry is to be written.
            return None
        except CorruptEntry as error:
            self._note(f"{path}: {error}; it is deleted and the weights are computed")
            with suppress(OSError):  # a folder stays, and is in the way when the entry is written
                path.unlink()
            return None
        with suppress(OSError):  # a cache that may only be read serves all the same
            os.utime(path)
        return entry

    def write(self, key: str, entry: CacheEntry) -> None:
        """Keep an entry, and make room for it; what cannot be written is remarked."""
        parts = pack_entry(key, entry)
        size = sum(map(len, parts))
        if size > self.max_bytes:
            self._note(f"holds {self.max_bytes} bytes at most, the weights have {size}: not kept")
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
        """Write beside the entry's name, which only its owner may read, and rename.

        Nothing waits for the disk: an entry that a power cut leaves in part fails its digest.
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
        """Delete the entries used longest ago, until the others fit, and what was left unfinished.

        Others may do the same meanwhile: what has gone already is as good as deleted here.
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
    """The key of a binding: a digest of all its weights, notes and figures depend on, bit by bit.

    The faces of the rest pose are not of it, since weights belong to points. Nor are the threads,
    which do not change weights.
    """
    said = {
        "version": __version__,
        "algorithm": ALGORITHM_VERSIONS[settings.coordinates],
        **asdict(settings),
        "rest": len(rest.vertices),
        "cage": len(cage.vertices),
        "faces": len(cage.faces),
    }
    digest = hashlib.sha256(json.dumps(said, sort_keys=True).encode() + b"\n")
    for array in (rest.vertices, cage.vertices):
        digest.update(as_bytes(array, "<f8"))
    digest.update(as_bytes(cage.faces, "<i8"))
    return digest.hexdigest()


def _make_entry(binding: Binding, seconds: float) -> CacheEntry:
    return CacheEntry(
        faces=binding.cage.faces,
        weights=binding.weights,
        panels=binding.panels,
        estimated_error=binding.estimated_error,
        projected=binding.projected,
        notes=binding.notes,
        seconds=seconds,
    )
