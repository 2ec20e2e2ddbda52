"""Files as they lie on disk: of what kind, and what is in them when they are packed by gzip."""

import gzip
import io
import zlib
from pathlib import Path

from cageik_cli.util.errors import InputError

PACKED = ".gz"

LARGEST_RATIO = 100
"""A packed file may unpack to so many times its size; text of a mesh packs to a fifth or so."""

SMALL = 64 * 2**20
"""Bytes that a packed file may unpack to in any case."""


def kind_of(path: Path) -> str:
    """The suffix in lower case, of packed files with the one before it: `.obj`, `.obj.gz`."""
    suffix = path.suffix.lower()
    return Path(path.stem).suffix.lower() + suffix if suffix == PACKED else suffix


def stem_of(path: Path) -> str:
    """The name without its kind."""
    return path.name[: len(path.name) - len(kind_of(path))]


def unpacked(data: bytes, kind: str) -> bytes:
    """What a file of some kind holds, unpacked if it is packed.

    Raises
    ------
    InputError
        When it is damaged, or holds more than `LARGEST_RATIO` times its size and `SMALL`.
    """
    if not kind.endswith(PACKED):
        return data
    limit = max(SMALL, LARGEST_RATIO * len(data))
    try:
        content = gzip.GzipFile(fileobj=io.BytesIO(data)).read(limit + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"cannot be unpacked ({error}); pack or copy it again") from error
    if len(content) > limit:
        raise InputError(
            f"holds more than {limit} bytes in {len(data)}, expected {LARGEST_RATIO} times as many "
            "at most; unpack it if that is what it should be"
        )
    return content
