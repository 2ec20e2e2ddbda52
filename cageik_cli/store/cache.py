"""A folder of entries: what takes long to compute is kept under a key of all that it depends on.

Entries are weights, fits, built cages and rigs. An entry is a file that is named by its key. It is
written beside its name and renamed, and its digests are checked when it is read, so that neither a
killed process nor a damaged disk can leave an entry that is used. Any number of processes may use
the folder at once. When an entry cannot be read or written, a note says so and its content is
computed.

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
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from io import BufferedReader
from math import prod
from pathlib import Path
from types import UnionType
from typing import Any, BinaryIO, TypeVar

import numpy as np
from numpy.typing import NDArray

from cageik_cli.cages.bind import JudgedBinding
from cageik_cli.cages.settings import BUILDER_VERSION, BuildSettings
from cageik_cli.fit.fitted import FittedWeights
from cageik_cli.fit.settings import FIT_VERSION, FitRecord, FitSettings, FittedClip
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.weights.binding import Binding, Correction
from cageik_cli.method.weights.settings import COORDINATES, BindSettings
from cageik_cli.store.hdf5_fields import parse_record
from cageik_cli.util import compiled
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.files import open_locked, remove_locked
from cageik_cli.util.json_files import parse_json
from cageik_cli.util.messages import Note
from cageik_cli.util.outputs import clear_leftovers, make_unfinished_path
from cageik_cli.util.version import __version__

Value = TypeVar("Value")


LOCK_POLL_SECONDS = 0.05
"""Seconds between two checks whether another process has computed an entry."""

MAX_UNFINISHED_SECONDS = 3600.0
"""Seconds after which an unfinished file of any machine is taken for one of a killed process."""

_ENTRY_NAME = re.compile(r"[0-9a-f]{64}\.(weights|cage|fit|rig)")


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
                    header: dict[str, Any] = parse_json(text)
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


WEIGHTS = EntryFormat(
    "weights",
    "the weights are",
    {"faces": "<i8", "weights": "<f8"},
    {
        "panels": int,
        "estimated_error": float,
        "projected": int,
        "notes": tuple,
        "cage_warnings": tuple,
        "has_loose_cage": bool | None,
    },
)
"""How a binding is kept: the faces of its cage, outward, its weights, and what is known of them."""

FITS = EntryFormat(
    "fit", "the weights are", {"weights": "<f8", "columns": "<f8", "basis": "<f8"}, {"record": str}
)
"""How fitted weights are kept: with their change of low rank, empty for other forms, and the record
of the fit without its clips, as JSON.
"""

CAGES = EntryFormat(
    "cage",
    "the cage is",
    {"vertices": "<f8", "faces": "<i8"},
    {"description": str, "notes": tuple},
)
"""How a built cage is kept: vertices (n, 3) in file units and faces, what was built in a line, and
what the user should know of it, a sentence each.
"""

RIGS = EntryFormat(
    "rig",
    "the skin is",
    {
        "joints": "<i8",
        "weights": "<f8",
        "cage": "<f8",
        "faces": "<i8",
        "labels": "<i8",
        "limbs": "<i8",
        "rotations": "<f8",
        "frame_errors": "<f8",
        "places": "<f8",
        "turns": "<f8",
        "jumps": "<i8",
    },
    {
        "rms": float,
        "largest": float,
        "angles": tuple | None,
        "roughness": float | None,
        "is_posed": bool,
    },
)
"""How a rig is kept: its skin weights, the joints at rest and in all frames, and its figures."""


def find_binding(
    cache: EntryCache,
    rest: TriMesh,
    cage: TriMesh,
    settings: BindSettings,
    compute: Callable[[], JudgedBinding],
) -> JudgedBinding:
    """Return the binding that `compute` gives, from the cache if it is there."""

    def to_entry(judged: JudgedBinding) -> Entry:
        binding = judged.binding
        return {
            "faces": binding.cage.faces,
            "weights": binding.weights,
            "panels": binding.panels,
            "estimated_error": binding.estimated_error,
            "projected": binding.projected,
            "notes": tuple(note.pack() for note in binding.notes),
            "cage_warnings": tuple(note.pack() for note in judged.cage_warnings),
            "has_loose_cage": judged.has_loose_cage,
        }

    def from_entry(entry: Entry) -> JudgedBinding:
        _check_shape(entry["weights"], len(rest.vertices), len(cage.vertices))
        is_outward = np.array_equal(cage.faces, entry.pop("faces"))
        warnings, entry["notes"] = (
            tuple(map(Note.unpack, entry.pop(name))) for name in ("cage_warnings", "notes")
        )
        is_loose = entry.pop("has_loose_cage")
        outward = cage if is_outward else cage.flip()
        return JudgedBinding(Binding(rest, outward, settings=settings, **entry), warnings, is_loose)

    key = compute_weight_key(rest, cage, settings)
    return cache.find_or_compute(WEIGHTS, key, compute, to_entry, from_entry)


def compute_weight_key(rest: TriMesh, cage: TriMesh, settings: BindSettings) -> str:
    """Return the key of a binding: a digest of all that its weights, notes and figures depend on.

    It covers the faces of the rest pose, on which warnings depend; not the number of threads, which
    does not change weights. The compiled core does, in the eighth digit: the equations are solved
    in single precision, which enlarges differences in the last bit.
    """
    recorded = {
        "version": __version__,
        "algorithm": COORDINATES[settings.coordinates].version,
        "compiled": compiled.kernel is not None,
        **asdict(settings),
    }
    return compute_key(recorded, rest.vertices, cage.vertices, rest.faces, cage.faces)


def find_fit(
    cache: EntryCache,
    key: str,
    binding: Binding,
    clips: tuple[FittedClip, ...],
    fit: Callable[[], FittedWeights],
) -> FittedWeights:
    """Return what `fit` makes of a binding, from the cache if it is there.

    The key is of `compute_fit_key`. The record names `clips`, whose files may have had other names
    when they were fitted.
    """

    def to_entry(fitted: FittedWeights) -> Entry:
        change = fitted.low_rank or Correction.none(0, 0)
        record = json.dumps(asdict(replace(fitted.fit, clips=())))
        weights = fitted.binding.weights
        arrays = {"weights": weights, "columns": change.columns, "basis": change.basis}
        return {**arrays, "record": record}

    def from_entry(entry: Entry) -> FittedWeights:
        record: FitRecord = parse_record(FitRecord, parse_json(entry["record"].encode()), "fit")
        change = Correction(entry["columns"], entry["basis"])
        rows, columns = binding.weights.shape
        _check_shape(entry["weights"], rows, columns)
        if record.settings.rank is not None:
            _check_shape(change.columns, rows, change.basis.shape[1])
            _check_shape(change.basis, columns, change.basis.shape[1])
        has_offsets = record.settings.influences is not None
        return FittedWeights(
            replace(binding, weights=entry["weights"], has_offsets=has_offsets),
            fit=replace(record, clips=clips),
            low_rank=None if record.settings.rank is None else change,
            unfitted=binding,
        )

    return cache.find_or_compute(FITS, key, fit, to_entry, from_entry)


def compute_fit_key(
    binding: Binding,
    settings: FitSettings,
    frames: Sequence[Sequence[bytes]],
    *,
    solve: SolveSettings,
    vertex_weights: Floats | None,
    memory: int,
    skips_bad_frames: bool,
    places: Integers | None = None,
) -> str:
    """Return the key of a fit: a digest of all that the fitted weights depend on.

    Threads are not in it; memory is, since fewer frames are fitted with little of it.

    Parameters
    ----------
    binding : Binding
        The weights that they are fitted from.
    frames : sequence of sequence of bytes
        For each clip, the digest of each frame.
    places : (m,) int64, optional
        Which place each vertex is at, where some never come apart and are fitted as one.
    """
    recorded = {
        "version": __version__,
        "algorithm": FIT_VERSION,
        "settings": asdict(settings),
        "solve": asdict(solve),
        "memory": memory,
        "skips": skips_bad_frames,
        "frames": [[digest.hex() for digest in clip] for clip in frames],
    }
    others = [array for array in (vertex_weights, places) if array is not None]
    meshes = [
        array for mesh in (binding.rest, binding.cage) for array in (mesh.vertices, mesh.faces)
    ]
    return compute_key(recorded, binding.weights, *meshes, *others)


def find_rig(
    cache: EntryCache,
    key: str,
    fit: Callable[[], Value],
    to_entry: Callable[[Value], Entry],
    from_entry: Callable[[Entry], Value],
) -> Value:
    """Return the rig that `fit` gives, from the cache if it is there; see `compute_rig_key`."""
    return cache.find_or_compute(RIGS, key, fit, to_entry, from_entry)


def compute_rig_key(binding: Binding, settings: Mapping[str, Any], frames: str) -> str:
    """Return the key of a rig: a digest of all that its skin and its joints depend on.

    Parameters
    ----------
    binding : Binding
        Of the mesh that the rig moves.
    settings : mapping
        Plain values, by name: those of the fit and of the solve, and the version of both.
    frames : str
        The digest of what the rig follows.
    """
    recorded = {
        "version": __version__,
        "fit": FIT_VERSION,
        "compiled": compiled.kernel is not None,
        "offsets": binding.has_offsets,
        "frames": frames,
        **settings,
    }
    polygons, cage = binding.rest.polygons, binding.cage
    surface = (binding.rest.faces, polygons.corners, polygons.corner_counts)
    return compute_key(
        recorded, binding.weights, binding.rest.vertices, *surface, cage.vertices, cage.faces
    )


def find_cage(
    cache: EntryCache, model: TriMesh, settings: BuildSettings, build: Callable[[], Entry]
) -> Entry:
    """Return the entry of the cage that `build` gives, from the cache if it is there."""

    def from_entry(entry: Entry) -> Entry:
        TriMesh(entry["vertices"], entry["faces"])  # refuses arrays that are none
        return entry

    return cache.find_or_compute(CAGES, compute_cage_key(model, settings), build, dict, from_entry)


def _check_shape(array: NDArray[Any], rows: int, columns: int) -> None:
    if array.shape != (rows, columns):
        raise CorruptEntry(f"has an array of shape {array.shape}, expected ({rows}, {columns})")


def compute_cage_key(model: TriMesh, settings: BuildSettings) -> str:
    """Return the key of a cage: a digest of all that it and its notes depend on.

    All settings are in it, since each changes the cage; how a cage is built, such as in how many
    processes, is no setting of it.
    """
    recorded = {"version": __version__, "builder": BUILDER_VERSION, **asdict(settings)}
    return compute_key(recorded, model.vertices, model.faces)
