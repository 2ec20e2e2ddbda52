"""The file of an entry of the cache of weights, of which every byte is digested.

It is a line that says what it is; the digest and the length of a JSON header; the header, which has
the digest of the arrays; the arrays.
"""

import hashlib
import json
import os
import stat
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

_MAGIC = b"cageik weights 1\n"
_DIGEST = hashlib.sha256().digest_size
_START = struct.Struct(f"<{len(_MAGIC)}s{_DIGEST}sQ")


class Unusable(Exception):
    """What an entry's name leads to is not that entry, whole."""


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
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


def packed(key: str, entry: Entry) -> list[memoryview]:
    """The parts of an entry's file, one behind the other."""
    arrays = [as_bytes(entry.faces, "<i8"), as_bytes(entry.weights, "<f8")]
    header = {
        "key": key,
        "digest": _digest(arrays).hex(),
        "faces": entry.faces.shape,
        "weights": entry.weights.shape,
        "panels": entry.panels,
        "estimated_error": entry.estimated_error,
        "projected": entry.projected,
        "notes": entry.notes,
        "seconds": entry.seconds,
    }
    text = json.dumps(header).encode()
    start = _START.pack(_MAGIC, _digest([memoryview(text)]), len(text))
    return [memoryview(start + text), *arrays]


def read_entry(path: Path, key: str) -> Entry:
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
        raise Unusable("is not a plain file")
    with open(path, "rb") as file:
        header = _header(file)
        if header.pop("key") != key:
            raise Unusable("is the entry of another key")
        expected = bytes.fromhex(header.pop("digest"))
        faces = np.empty(header.pop("faces"), "<i8")
        weights = np.empty(header.pop("weights"), "<f8")
        parts = [as_bytes(faces, "<i8"), as_bytes(weights, "<f8")]
        whole = all(file.readinto(part) == len(part) for part in parts)
        if not whole or file.read(1) or _digest(parts) != expected:
            raise Unusable("is damaged")
    return Entry(
        faces=faces.astype(np.int64, copy=False),
        weights=weights.astype(np.float64, copy=False),
        notes=tuple(header.pop("notes")),
        **header,
    )


def as_bytes(array: np.ndarray, kind: str) -> memoryview:
    """The numbers of an array, row by row, as bytes."""
    return np.ascontiguousarray(array, kind).reshape(-1).view(np.uint8).data


def _header(file: BinaryIO) -> dict[str, Any]:
    """The header as it was written, or none; only then is it believed how long the arrays are."""
    start = file.read(_START.size)
    if len(start) == _START.size:
        magic, expected, length = _START.unpack(start)
        if magic == _MAGIC and length <= os.fstat(file.fileno()).st_size:
            text = file.read(length)
            if _digest([memoryview(text)]) == expected:
                header: dict[str, Any] = json.loads(text)
                return header
    raise Unusable("is damaged")


def _digest(parts: list[memoryview]) -> bytes:
    """SHA-256, for which processors have instructions: twice as fast as others."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.digest()
