"""What is in a file: its bytes, unpacked if gzip packed them, and their digest."""

import codecs
import gzip
import hashlib
import io
import zlib
from collections.abc import Hashable
from functools import cache
from importlib import import_module
from math import prod
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

import numpy as np

import cageik_cli.formats
from cageik_cli.util.errors import FileAccessError, FormatError, error_context
from cageik_cli.util.files import HEAD_BYTES, check_content, open_input
from cageik_cli.util.messages import say
from cageik_cli.util.text import format_bytes, to_unicode

GZIP_SUFFIX = ".gz"

MAX_UNPACKED_RATIO = 40
"""What is packed may unpack to this many times its size; frames and meshes pack to 1/2 to 1/10."""

MIN_UNPACKED_LIMIT = 1 << 20
"""Bytes that may be unpacked in any case."""

MAX_INSTANCED_BYTES = 160 << 20
"""Memory that meshes and their instances may take in any case; what joins and describes them takes
five times as much."""

PART_BYTES = 5000
"""Memory that a part takes besides its arrays: its paths, its transforms and what reads it."""

TEXT_SAMPLE_BYTES = 84
"""Bytes that tell whether a file with a mark of Unicode is a text: the header and the count of a
binary STL have a zero among them."""


def with_gzip(*suffixes: str) -> tuple[str, ...]:
    """Return the suffixes, and behind them those of the same files packed by gzip."""
    return (*suffixes, *(suffix + GZIP_SUFFIX for suffix in suffixes))


def require_unicode(path: Path) -> str:
    """Return a path as text, for a library that takes no other names.

    Raises
    ------
    FileAccessError
        When its bytes are no UTF-8; the path is not named.
    """
    text = str(path)
    if to_unicode(text) != text:
        raise FileAccessError(
            "has a name, or a folder, that is not Unicode, which this format cannot have; rename it"
        )
    return text


def file_suffix(path: Path) -> str:
    """Return the suffix in lower case, with the one before `.gz`: `.obj`, `.obj.gz`."""
    suffix = path.suffix.lower()
    return Path(path.stem).suffix.lower() + suffix if suffix == GZIP_SUFFIX else suffix


def file_stem(path: Path) -> str:
    """Return the name without its suffix."""
    return path.name[: len(path.name) - len(file_suffix(path))]


def compute_unpacked_limit(packed: int) -> int:
    """Return how many bytes may be unpacked of as many packed ones.

    A few kilobytes of zeros could fill memory and disk.
    """
    return max(MIN_UNPACKED_LIMIT, MAX_UNPACKED_RATIO * packed)


def check_unpacked_size(size: int, packed: int) -> None:
    """Refuse what takes more bytes, unpacked, than `compute_unpacked_limit` says."""
    limit = compute_unpacked_limit(packed)
    if size > limit:
        raise FormatError(
            f"takes at least {size} bytes, packed in {packed}, expected at most {limit}; it is "
            "damaged, or store it without compression and instances"
        )


class ClaimedBytes:
    """Counts the bytes of the arrays of a file, which may name one array a million times.

    Instances of a mesh are no sign of damage. What they read again is counted apart, and so is what
    the meshes take in memory. Only beyond `MAX_INSTANCED_BYTES` of either, instances count as all
    else does.

    `packed` is the size of the file, or of all files that were read for it.
    """

    def __init__(self, packed: int) -> None:
        self.packed, self._claimed, self._copied, self._held = packed, 0, 0, 0
        self._seen: set[Hashable] = set()

    def claim(self, size: int) -> None:
        """Count bytes that are taken; refuse too many, as `check_unpacked_size` does."""
        self._claimed += size
        check_unpacked_size(self._claimed, self.packed)

    def claim_copy(self, size: int) -> None:
        """Count bytes that an instance takes of what the file holds once; refuse too many."""
        self._copied += size
        self._check_instances()

    def hold(self, size: int) -> None:
        """Count bytes that meshes take in memory, with their instances; refuse too many."""
        self._held += size
        self._check_instances()

    def distinguish(self, source: Hashable) -> "ClaimedBytes":
        """Return what counts the arrays of a mesh: as copies, if its source was here before."""
        if source in self._seen:
            return _CopiedBytes(self)
        self._seen.add(source)
        return self

    def _check_instances(self) -> None:
        taken = max(self._copied, self._held)
        unpacked = max(self._claimed + self._copied, self._held)
        is_packed = unpacked > compute_unpacked_limit(self.packed)
        if taken > MAX_INSTANCED_BYTES and is_packed:
            raise FormatError(
                f"takes at least {format_bytes(taken)} of memory with all instances of its meshes, "
                f"expected at most {format_bytes(MAX_INSTANCED_BYTES)}, as the file has "
                f"{format_bytes(self.packed)}; name one of its groups as FILE::PATH"
                + say(", leave some out by `exclude=`, or export fewer instances")
            )


class _CopiedBytes(ClaimedBytes):
    """Counts the bytes of arrays that were counted before, of the mesh that one is a copy of."""

    def __init__(self, whole: ClaimedBytes) -> None:
        super().__init__(whole.packed)
        self._whole = whole

    def claim(self, size: int) -> None:
        """Count bytes that are taken as those of a copy."""
        self._whole.claim_copy(size)


def check_unpacked_array(shape: tuple[int, ...], kind: np.dtype[Any], packed: int) -> None:
    """Refuse an array that takes too many bytes, unpacked; raises as `check_unpacked_size`.

    Whole numbers count eight bytes each: indices of one byte take eight where they are computed
    with.
    """
    width = 8 if kind.kind in "iu" else kind.itemsize
    check_unpacked_size(prod(shape) * width, packed)


def decompress(data: bytes, suffix: str) -> bytes:
    """Return the content of a file of some suffix, unpacked if it is packed.

    A text in UTF-16, as redirections of PowerShell write it, is returned in UTF-8, and without the
    mark of that.

    Raises
    ------
    FormatError
        When it is damaged, or unpacks to more than `compute_unpacked_limit` says.
    """
    if not suffix.endswith(GZIP_SUFFIX):
        return _check_text(_to_utf8(data))
    limit = compute_unpacked_limit(len(data))
    try:
        content = gzip.GzipFile(fileobj=io.BytesIO(data)).read(limit + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise FormatError(f"cannot be unpacked ({error}); pack or copy it again") from error
    check_unpacked_size(len(content), len(data))
    return _check_text(_to_utf8(content))


def _check_text(content: bytes) -> bytes:
    """Return the content, if it is not what came in place of the file."""
    check_content(content[:HEAD_BYTES])
    return content


def _to_utf8(data: bytes) -> bytes:
    """Return a text that is marked as UTF-8 or UTF-16 in UTF-8, without the mark; others as is.

    A binary file may begin like a mark, too, but has other characters soon.
    """
    marks = {codecs.BOM_UTF8: "utf-8", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
    encoding = next((name for mark, name in marks.items() if data.startswith(mark)), None)
    if encoding is None or "\0" in data[:TEXT_SAMPLE_BYTES].decode(encoding, "ignore"):
        return data
    if encoding == "utf-8":
        return data.removeprefix(codecs.BOM_UTF8)
    return data.decode(encoding, "replace").removeprefix("\ufeff").encode()


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


@cache
def discover_plugins(class_name: str) -> dict[str, Any]:
    """Return the classes called `class_name` of all formats, by the suffixes that they take.

    Modules without such a class are skipped.

    Raises
    ------
    ValueError
        When two formats take one suffix.
    """
    package = cageik_cli.formats
    found: dict[str, Any] = {}
    for name in sorted(module.name for module in iter_modules(package.__path__)):
        kind = getattr(import_module(f"{package.__name__}.{name}"), class_name, None)
        for suffix in kind.suffixes if kind is not None else ():
            if found.setdefault(suffix, kind) is not kind:
                raise ValueError(
                    f"{suffix}: both {found[suffix].__module__} and {kind.__module__} are a "
                    f"{class_name} of it"
                )
    return found
