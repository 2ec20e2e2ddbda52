"""Images of vectors from 0 to 1, written row by row: PNG of 16 bits, or OpenEXR of 32.

Pillow writes neither.
"""

import struct
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from cageik_cli.util.arrays import Floats

PNG_MAX = 2**16 - 1


def write_png(path: Path, size: tuple[int, int], rows: Iterable[Floats]) -> None:
    """Write an image of 16 bits per channel, red, green and blue, without a colour space.

    Parameters
    ----------
    size : (int, int)
        Width and height.
    rows : iterable of (k, 3)
        Rows from the top, with values from 0 to 1, which are rounded. What they leave at the right
        and at the bottom is black.

    References
    ----------
    PNG specification (third edition), sections 5, 9 and 11.
    """
    width, height = size
    with path.open("wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        _write_chunk(file, b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0))
        packer = zlib.compressobj()
        above = np.zeros(6 * width, np.uint8)
        for row in _fill_rows(size, rows):
            values = np.rint(row * PNG_MAX).astype(">u2").reshape(-1).view(np.uint8)
            # Filter 2: the difference from the row above, which is the frame before.
            data = packer.compress(b"\2" + (values - above).tobytes())
            above = values
            if data:
                _write_chunk(file, b"IDAT", data)
        _write_chunk(file, b"IDAT", packer.flush())
        _write_chunk(file, b"IEND", b"")


def _write_chunk(file: BinaryIO, kind: bytes, data: bytes) -> None:
    file.write(struct.pack(">I", len(data)) + kind + data)
    file.write(struct.pack(">I", zlib.crc32(kind + data)))


def write_exr(path: Path, size: tuple[int, int], rows: Iterable[Floats]) -> None:
    """Write an image of float32 per channel, by scan lines that are compressed one by one.

    Parameters are as of `write_png`.

    References
    ----------
    OpenEXR file layout; compression ZIPS: the bytes of a line, those of even places first, as
    differences, by zlib.
    """
    width, height = size
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    channels = b"".join(name + struct.pack("<xi4xii", 2, 1, 1) for name in (b"B", b"G", b"R"))
    attributes = {
        "channels": ("chlist", channels + b"\0"),
        "compression": ("compression", b"\2"),
        "dataWindow": ("box2i", window),
        "displayWindow": ("box2i", window),
        "lineOrder": ("lineOrder", b"\0"),
        "pixelAspectRatio": ("float", struct.pack("<f", 1)),
        "screenWindowCenter": ("v2f", struct.pack("<2f", 0, 0)),
        "screenWindowWidth": ("float", struct.pack("<f", 1)),
    }
    with path.open("wb") as file:
        file.write(struct.pack("<II", 20000630, 2))
        for name, (kind, value) in attributes.items():
            file.write(f"{name}\0{kind}\0".encode() + struct.pack("<I", len(value)) + value)
        file.write(b"\0")
        places = file.tell()
        file.write(bytes(8 * height))
        offsets = np.zeros(height, "<u8")
        for k, row in enumerate(_fill_rows(size, rows)):
            offsets[k] = file.tell()
            data = _pack_line(row)
            file.write(struct.pack("<iI", k, len(data)) + data)
        file.seek(places)
        file.write(offsets.data)


def _pack_line(row: Floats) -> bytes:
    """Return a line of OpenEXR: all of blue, of green and of red."""
    plain = np.ascontiguousarray(row[:, ::-1].T, "<f4").view(np.uint8).reshape(-1)
    parted = np.concatenate([plain[::2], plain[1::2]])
    parted[1:] = parted[1:] - parted[:-1] + np.uint8(128)
    packed = zlib.compress(parted.tobytes())
    return packed if len(packed) < len(plain) else plain.tobytes()


def _fill_rows(size: tuple[int, int], rows: Iterable[Floats]) -> Iterable[NDArray[np.float64]]:
    """Yield whole rows, (width, 3), also those that are left."""
    width, height = size
    count = 0
    for row in rows:
        whole = np.zeros((width, 3))
        whole[: len(row)] = row
        yield whole
        count += 1
    for _ in range(height - count):
        yield np.zeros((width, 3))
