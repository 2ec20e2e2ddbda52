"""What is in a file: its bytes, unpacked if gzip packed them, and their digest."""

import gzip
import hashlib
import io
import zlib
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.util.errors import FileAccessError, FormatError, error_context
from cageik_cli.util.files import open_input
from cageik_cli.util.text import to_unicode

GZIP_SUFFIX = ".gz"

MAX_UNPACKED_RATIO = 40
"""What is packed may unpack to this many times its size; frames and meshes pack to 1/2 to 1/10."""

MIN_UNPACKED_LIMIT = 1 << 20
"""Bytes that may be unpacked in any case."""


def with_gzip(*suffixes: str) -> tuple[str, ...]:
    """Return the suffixes, and behind them those of the same files packed by gzip."""
    return (*suffixes, *(suffix + GZIP_SUFFIX for suffix in suffixes))


def compute_unpacked_limit(packed: int) -> int:
    """Return how many bytes may be unpacked of as many packed ones.

    A few kilobytes of zeros could fill memory and disk.
    """
    return max(MIN_UNPACKED_LIMIT, MAX_UNPACKED_RATIO * packed)


def check_unpacked_size(size: int, packed: int) -> None:
    """Refuse what takes more bytes, unpacked, than `compute_unpacked_limit` says.

    Raises
    ------
    FormatError
    """
    limit = compute_unpacked_limit(packed)
    if size > limit:
        raise FormatError(
            f"takes at least {size} bytes, packed in {packed}, expected at most {limit}; it is "
            "damaged, or store it without compression"
        )


def check_unpacked_array(shape: tuple[int, ...], kind: np.dtype[Any], packed: int) -> None:
    """Refuse an array that takes too many bytes, unpacked; raises as `check_unpacked_size`.

    Whole numbers count eight bytes each: indices of one byte take eight where they are computed
    with.
    """
    width = 8 if kind.kind in "iu" else kind.itemsize
    check_unpacked_size(prod(shape) * width, packed)


def decompress(data: bytes, suffix: str) -> bytes:
    """Return the content of a file of some suffix, unpacked if it is packed.

    Raises
    ------
    FormatError
        When it is damaged, or unpacks to more than `compute_unpacked_limit` says.
    """
    if not suffix.endswith(GZIP_SUFFIX):
        return data
    limit = compute_unpacked_limit(len(data))
    try:
        content = gzip.GzipFile(fileobj=io.BytesIO(data)).read(limit + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise FormatError(f"cannot be unpacked ({error}); pack or copy it again") from error
    check_unpacked_size(len(content), len(data))
    return content


def hash_file(path: Path) -> bytes:
    """Return the SHA-256 digest of a file."""
    with error_context(path):
        try:
            with open_input(path) as stream:
                return hashlib.file_digest(stream, "sha256").digest()
        except OSError as error:
            raise FileAccessError(f"cannot be read: {error.strerror or error}") from error


def describe_file(path: Path) -> dict[str, str]:
    """Return what is recorded of a file that is not read as a whole: its name and digest."""
    return {"name": to_unicode(path.name), "sha256": hash_file(path).hex()}


def describe_source(path: Path, data: bytes) -> dict[str, str]:
    """Return what is recorded of a file that was read: its name and digest."""
    return {"name": to_unicode(path.name), "sha256": hashlib.sha256(data).hexdigest()}
