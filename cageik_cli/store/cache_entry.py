"""An entry of the cache as a file: arrays and plain values behind digests.

Entries are not HDF5 files: read through HDF5, a hit takes 1.3 to 1.4 times as long.
"""

import hashlib
import json
import os
import stat
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from io import BufferedReader
from math import prod
from pathlib import Path
from types import UnionType
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

Entry = dict[str, Any]
"""The arrays and plain values of an entry, by name."""


class CorruptEntry(Exception):
    """A file under the name of an entry is not that entry, or not all of it."""


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


def _as_bytes(array: np.ndarray, dtype: "str | np.dtype[Any]") -> memoryview:
    """Return the numbers of an array, row by row, as bytes."""
    return np.ascontiguousarray(array, dtype).reshape(-1).view(np.uint8).data


def _compute_digest(parts: list[memoryview]) -> bytes:
    """Return the SHA-256, for which processors have instructions: twice as fast as others."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.digest()
