"""Arrays and a header in one packed text, which a page holds and its script unpacks.

The text is base64 of gzip of: the length of the header (4 bytes, little-endian), the header as
JSON, and the arrays, one after another. The header lists them under `arrays`. The bytes of an array
are stored by place: the first bytes of all numbers, then the second ones. That packs better.
"""

import base64
import json
import struct
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

TYPES = {"f4": "<f4", "i1": "|i1", "i2": "<i2", "u2": "<u2", "u4": "<u4"}
"""Types of numbers, by their names in the header."""

GZIP_HEADER = bytes([0x1F, 0x8B, 8, 0, 0, 0, 0, 0, 0, 0xFF])
"""Of gzip without a time and a system: the same bytes everywhere."""


def pack_arrays(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> str:
    """Pack a header and arrays.

    Parameters
    ----------
    header : mapping
        Values that JSON can hold; no number that is not finite.
    arrays : mapping of str to array
        Of a type that `TYPES` has.

    Returns
    -------
    str
        Letters, digits, `+`, `/` and `=`: the same for the same arguments.
    """
    listed, parts = [], []
    for name, array in arrays.items():
        kind = next(k for k, dtype in TYPES.items() if array.dtype == np.dtype(dtype))
        listed.append({"name": name, "type": kind, "shape": list(array.shape)})
        little = np.ascontiguousarray(array, TYPES[kind])
        parts.append(little.reshape(-1, 1).view(np.uint8).T.tobytes())
    text = json.dumps({**header, "arrays": listed}, allow_nan=False, separators=(",", ":"))
    encoded = text.encode()
    content = b"".join([struct.pack("<I", len(encoded)), encoded, *parts])
    return base64.b64encode(_compress(content)).decode()


def unpack_arrays(text: str) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Unpack what `pack_arrays` packed: the header, and the arrays by name."""
    content = zlib.decompress(base64.b64decode(text, validate=True), wbits=31)
    (length,) = struct.unpack_from("<I", content)
    header, start = json.loads(content[4 : 4 + length]), 4 + length
    arrays = {}
    for one in header.pop("arrays"):
        dtype = np.dtype(TYPES[one["type"]])
        count = int(np.prod(one["shape"]))
        planes = np.frombuffer(content, np.uint8, count * dtype.itemsize, start)
        numbers = np.ascontiguousarray(planes.reshape(dtype.itemsize, count).T).view(dtype)
        arrays[one["name"]] = numbers.reshape(one["shape"])
        start += count * dtype.itemsize
    return header, arrays


def _compress(content: bytes) -> bytes:
    """Return gzip of `content`."""
    # Differences are small numbers without repeated texts: this strategy is made for them. A higher
    # level looks for such texts: level 9 takes nine times as long, for 1 % less.
    packer = zlib.compressobj(5, zlib.DEFLATED, -zlib.MAX_WBITS, strategy=zlib.Z_FILTERED)
    packed = packer.compress(content) + packer.flush()
    end = struct.pack("<II", zlib.crc32(content), len(content) & 0xFFFFFFFF)
    return GZIP_HEADER + packed + end
