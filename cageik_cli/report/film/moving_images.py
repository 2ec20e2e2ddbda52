"""Moving images as GIF and WebP, which are written picture by picture.

Pillow encodes single pictures; here they are joined. It would keep all of a GIF, and all encoded
ones of a WebP, until the last is there.

References
----------
CompuServe, Graphics Interchange Format, version 89a.
RFC 9649, WebP image format, section 2.7.
"""

import io
import struct
from abc import ABC, abstractmethod
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Pixels = NDArray[np.uint8]
"""(h, w, 3): red, green and blue."""

GIF_COLOURS = 127
"""Colours of a GIF; one more stands for what has not changed."""

WEBP_QUALITY = 75
"""Of the pictures of a WebP, up to 100: the thin lines of a cage stay clean."""


class MovingImage(ABC):
    """A moving image on its way into a file, which begins again after its last picture.

    Parameters
    ----------
    file : binary file
        It can be written at any place.
    width, height : int
        In pixels.
    samples : (h, w, 3) uint8
        Pixels with the colours of all pictures.
    """

    PARTS_PER_SECOND: int
    """In which times are given."""

    def __init__(self, file: BinaryIO, width: int, height: int, samples: Pixels) -> None:
        self._file, self._size = file, (width, height)
        self._begin(samples)

    @abstractmethod
    def _begin(self, samples: Pixels) -> None:
        """Write what comes before all pictures."""

    @abstractmethod
    def add(self, pixels: Pixels, duration: int) -> None:
        """Add a picture, and how long it is shown."""

    @abstractmethod
    def end(self) -> None:
        """Write what comes after all pictures."""


class GifImage(MovingImage):
    """A moving GIF of `GIF_COLOURS` colours, which are the same in all pictures."""

    PARTS_PER_SECOND = 100

    def _begin(self, samples: Pixels) -> None:
        found = Image.fromarray(samples).quantize(
            GIF_COLOURS, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE
        )
        colours = (found.getpalette() or [])[: 3 * GIF_COLOURS]
        self._table = bytes(colours).ljust(3 * (GIF_COLOURS + 1), b"\0")
        # All places but those of the colours repeat the first, so that nothing is drawn with them.
        self._palette = Image.new("P", (1, 1))
        self._palette.putpalette((colours + colours[:3] * 256)[:768])
        self._before: Pixels | None = None
        bits = GIF_COLOURS.bit_length()
        head = struct.pack("<6sHHBBB", b"GIF89a", *self._size, 0xF0 | (bits - 1), 0, 0)
        forever = b"\x21\xff\x0bNETSCAPE2.0\x03\x01\0\0\0"
        self._file.write(head + self._table + forever)

    def add(self, pixels: Pixels, duration: int) -> None:
        """Add a picture; what has not changed shows through."""
        image = Image.fromarray(pixels).quantize(palette=self._palette, dither=Image.Dither.NONE)
        colours = np.asarray(image)
        # Of equal colours, the first: there is then nothing beyond the table.
        colours = np.where(colours < GIF_COLOURS, colours, 0).astype(np.uint8)
        is_new = np.ones(colours.shape, bool) if self._before is None else colours != self._before
        rows, columns = find_rectangle(is_new)
        shown = np.where(is_new, colours, GIF_COLOURS).astype(np.uint8)[rows, columns]
        self._before = colours
        control = struct.pack("<BBBBHBB", 0x21, 0xF9, 4, 0x05, duration, GIF_COLOURS, 0)
        place = (columns.start, rows.start, *shown.shape[::-1])
        self._file.write(control + struct.pack("<BHHHHB", 0x2C, *place, 0) + self._encode(shown))

    def _encode(self, colours: Pixels) -> bytes:
        """Return the compressed data of a picture, which Pillow writes as a file of its own."""
        image = Image.fromarray(colours, "P")
        image.putpalette(self._table)
        stream = io.BytesIO()
        image.save(stream, "GIF", optimize=False, interlace=False)
        data, table_at = stream.getvalue(), 13  # the head without the table of colours
        start = table_at + (3 << (data[10] & 7) + 1 if data[10] & 0x80 else 0)
        assert data[start] == 0x2C, "the picture follows the colours"
        assert data[start + 9] & 0x80 == 0, "and has no colours of its own"
        return data[start + 10 : -1]

    def end(self) -> None:
        """Write the last byte."""
        self._file.write(b";")


class WebpImage(MovingImage):
    """A moving WebP, whose pictures are encoded with a loss."""

    PARTS_PER_SECOND = 1000

    def _begin(self, samples: Pixels) -> None:
        sides = b"".join((side - 1).to_bytes(3, "little") for side in self._size)
        self._file.write(b"RIFF\0\0\0\0WEBP")  # the length is known at the end
        self._write_chunk(b"VP8X", bytes([0x02, 0, 0, 0]) + sides)
        self._write_chunk(b"ANIM", b"\xff\xff\xff\xff\0\0")

    def _write_chunk(self, name: bytes, content: bytes) -> None:
        padding = b"\0" * (len(content) % 2)
        self._file.write(name + struct.pack("<I", len(content)) + content + padding)

    def add(self, pixels: Pixels, duration: int) -> None:
        """Add a picture, all of it: what is plain takes nearly no bytes."""
        stream = io.BytesIO()
        Image.fromarray(pixels).save(stream, "WEBP", quality=WEBP_QUALITY, method=4)
        numbers = 0, 0, *(side - 1 for side in self._size), duration
        head = b"".join(number.to_bytes(3, "little") for number in numbers)
        replaces = b"\x02"  # what is there is replaced, not blended with
        self._write_chunk(b"ANMF", head + replaces + stream.getvalue()[12:])

    def end(self) -> None:
        """Write the length of the file where it belongs."""
        length = self._file.tell()
        self._file.seek(4)
        self._file.write(struct.pack("<I", length - 8))
        self._file.seek(length)


def find_rectangle(is_new: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Find the rows and columns of all that is new; of one pixel, if nothing is."""
    rows, columns = (np.flatnonzero(is_new.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return slice(0, 1), slice(0, 1)
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


IMAGE_TYPES: dict[str, type[MovingImage]] = {".gif": GifImage, ".webp": WebpImage}
"""The kinds of moving images, by the suffixes of their files."""
