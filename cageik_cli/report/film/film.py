"""A film of a result, the clip or a turn around the rest pose, as GIF or WebP.

Pictures are drawn one by one, and written as they are drawn. Pillow encodes single pictures; here
they are joined. It would keep all of a GIF, and all encoded ones of a WebP, until the last is
there.

References
----------
CompuServe, Graphics Interchange Format, version 89a.
RFC 9649, WebP image format, section 2.7.
"""

import io
import math
import struct
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from cageik_cli.method.weights.binding import Binding, reconstruct_frames
from cageik_cli.report.film.settings import (
    DEFAULT_TURN_SECONDS,
    MAX_FILM_RATE,
    MAX_FILM_SECONDS,
    TURN_RATE,
    FilmSettings,
)
from cageik_cli.report.render.model_views import (
    VIEW_TURN,
    project_surface,
    render_with_cage,
    view_axes,
)
from cageik_cli.report.render.raster import ParallelCamera
from cageik_cli.report.render.shading import SAMPLES_PER_PIXEL, downsample, parse_colour
from cageik_cli.store.result import Result, load_binding, read_cages, read_rotations
from cageik_cli.util.arrays import Floats, Integers, count_frames, spread_evenly
from cageik_cli.util.errors import SettingError
from cageik_cli.util.messages import say
from cageik_cli.util.outputs import atomic_file
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.threads import OrderedMap, count_processors

FILM_COLOURS = {"background": "#ffffff", "label": "#59626d"}
"""Of what is neither the model nor its cage."""

MAX_TILE_SIDE = 640
"""Pixels of a square that is drawn at once: larger pictures take no more memory."""

COLOUR_SAMPLES = 6
"""Pictures from which the colours of a GIF are chosen."""


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """One picture of a film.

    Attributes
    ----------
    mesh, cage : (m, 3) and (n, 3) float64
    axes : (3, 3) float64
        Of the camera, as of `ParallelCamera`.
    centre : (3,) float64
        What the camera goes around, or with.
    label : str
        What is written on the picture: the number of the frame.
    """

    mesh: Floats
    cage: Floats
    axes: Floats
    centre: Floats
    label: str


class FilmPlan:
    """The pictures of a film, which can be drawn several times.

    Parameters
    ----------
    result : Result
        With weights, which are those of `binding`.

    Attributes
    ----------
    rate : float
        Pictures per second.
    count : int
        Number of pictures.

    Raises
    ------
    SettingError
        When the whole clip is asked for and is too long.
    """

    def __init__(self, result: Result, binding: Binding, settings: FilmSettings) -> None:
        self.result, self.binding, self.settings = result, binding, settings
        seconds = settings.film_seconds
        if settings.film_turntable:
            self._step, self.rate = 1, TURN_RATE
            self.count = max(1, round((seconds or DEFAULT_TURN_SECONDS) * TURN_RATE))
            return
        fps = result.scene.fps
        if seconds is None and len(result.frames) > MAX_FILM_SECONDS * fps:
            raise SettingError(
                f"{result.path}: plays {len(result.frames) / fps:.0f} s, which is too long "
                f"for a film (expected at most {MAX_FILM_SECONDS:g} s); "
                + say("give its first seconds with `film_seconds=`")
            )
        shown = len(result.frames)
        if seconds is not None:
            shown = min(shown, max(1, round(seconds * fps)))
        self._step = max(1, math.ceil(fps / MAX_FILM_RATE - 1e-9))
        self.rate, self.count = fps / self._step, -(-shown // self._step)

    @property
    def seconds(self) -> float:
        """How long the film plays."""
        return self.count / self.rate

    def list_times(self, per_second: int) -> list[int]:
        """Return when pictures begin, and the last one ends, in parts of a second."""
        return [round(per_second * number / self.rate) for number in range(self.count + 1)]

    def shots(self) -> Iterator[Shot]:
        """Yield the pictures in order; the meshes of some are in memory at a time."""
        yield from self._turn() if self.settings.film_turntable else self._play()

    def _turn(self) -> Iterator[Shot]:
        rest, cage = self.binding.rest.vertices, self.binding.cage.vertices
        drawn = rest[np.unique(self.binding.rest.faces)]
        centre = 0.5 * (drawn.min(axis=0) + drawn.max(axis=0))
        for number in range(self.count):
            axes = view_axes(self.result.scene.up_axis, VIEW_TURN + 360 * number / self.count)
            yield Shot(rest, cage, axes, centre, "")

    def _play(self) -> Iterator[Shot]:
        result, follows = self.result, self.settings.film_follow
        axes = view_axes(result.scene.up_axis, VIEW_TURN)
        timeline = result.scene.make_timeline(len(result.frames))
        for number, (mesh, cage) in enumerate(islice(self._rebuild(), self.count)):
            # The mean of the cage moves evenly; the middle of a box around it would jerk.
            centre = cage.mean(axis=0) if follows else np.zeros(3)
            label = f"frame {timeline.number_frame(number * self._step)}"
            yield Shot(mesh, cage, axes, centre, label)

    def _rebuild(self) -> Iterator[tuple[Floats, Floats]]:
        """Yield the mesh and the cage of every frame that is shown, and perhaps of more."""
        count = count_frames(MAX_SHOT_BYTES, len(self.binding.rest.vertices))
        rotations = read_rotations(self.result) if self.binding.has_offsets else None
        start = 0
        for block in read_cages(self.result, count * self._step):
            cages = block[:: self._step]
            turns = None if rotations is None else rotations[start :: self._step][: len(cages)]
            yield from zip(reconstruct_frames(self.binding, cages, turns), cages, strict=True)
            start += len(block)


def write_film(
    result: Result,
    path: Path,
    settings: FilmSettings,
    overwrite: bool,
    progress: ProgressListener,
) -> FilmPlan:
    """Write a film as GIF or WebP, as the name says; the same bytes for the same arguments.

    Raises
    ------
    SettingError
        When the result has no weights, or its clip is too long.
    OutputError
        When the file cannot be written.
    """
    binding = load_binding(result, "a film")
    plan = FilmPlan(result, binding, settings)
    kind = IMAGE_TYPES[path.suffix.lower()]
    with progress.stage("film"):
        artist = FilmArtist.fit(plan)
        times = plan.list_times(kind.PARTS_PER_SECOND)
        jobs = count_processors()
        with (
            atomic_file(path, overwrite) as file,
            OrderedMap(artist.draw, plan.shots(), jobs, jobs + 1) as pictures,
        ):
            image = kind(file, *settings.film_size, artist.draw_samples())
            for number, pixels in enumerate(pictures):
                image.add(pixels, times[number + 1] - times[number])
                progress.update(number + 1, plan.count)
            image.end()
    return plan


Pixels = NDArray[np.uint8]
"""(h, w, 3): red, green and blue."""

MAX_SHOT_BYTES = 64 << 20
"""Bytes of the meshes of a film that are in memory at a time."""


@dataclass(frozen=True, slots=True, eq=False)
class FilmArtist:
    """Draws the shots of a plan at one scale.

    Attributes
    ----------
    offset : (3,) float64
        From the centre of a shot to the middle of its picture, along the axes of the camera.
    unit : float
        Size of a pixel, in units of the model.
    """

    plan: FilmPlan
    offset: Floats
    unit: float

    @classmethod
    def fit(cls, plan: FilmPlan) -> "FilmArtist":
        """Find the largest scale at which all that any shot shows is in the picture."""
        margin, label_height = 0.03, 20  # share of the picture; pixels
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        drawn: Integers = np.unique(plan.binding.rest.faces)
        for shot in plan.shots():
            for points in (shot.mesh[drawn], shot.cage):
                seen = (points - shot.centre) @ shot.axes.T
                low, high = np.minimum(low, seen.min(axis=0)), np.maximum(high, seen.max(axis=0))
        width, height = plan.settings.film_size
        room = (1 - 2 * margin) * np.array([width, height - label_height])
        unit = float(((high - low)[:2] / room).max()) or 1.0
        # The label is below the model.
        lift = np.array([0, -0.5 * label_height * unit, 0])
        return cls(plan, 0.5 * (low + high) + lift, unit)

    def draw_samples(self) -> Pixels:
        """Draw some of the shots below each other, for the choice of colours."""
        chosen = set(spread_evenly(self.plan.count, COLOUR_SAMPLES).tolist())
        shots = (shot for number, shot in enumerate(self.plan.shots()) if number in chosen)
        return np.concatenate([self.draw(shot) for shot in shots])

    def draw(self, shot: Shot) -> Pixels:
        """Draw a shot, (h, w, 3), with its label in the lower left corner."""
        width, height = self.plan.settings.film_size
        pixels: Pixels = np.empty((height, width, 3), np.uint8)
        tiles = [-(-side // MAX_TILE_SIDE) for side in (width, height)]
        side = max(-(-width // tiles[0]), -(-height // tiles[1]))
        for top in range(0, height, side):
            for left in range(0, width, side):
                part = pixels[top : top + side, left : left + side]
                part[:] = self._draw_tile(shot, left, top, side)[: part.shape[0], : part.shape[1]]
        if not shot.label:
            return pixels
        image = Image.fromarray(pixels)
        margin, size = 8, 13.0  # pixels
        place, font = (margin, height - margin), ImageFont.load_default(size)
        colour = FILM_COLOURS["label"]
        ImageDraw.Draw(image).text(place, shot.label, colour, font, anchor="ls")
        return np.asarray(image)

    def _draw_tile(self, shot: Shot, left: int, top: int, side: int) -> Pixels:
        """Draw a square whose upper left corner is at a pixel."""
        width, height = self.plan.settings.film_size
        right, down = left + 0.5 * (side - width), top + 0.5 * (side - height)
        place = self.offset + self.unit * np.array([right, -down, 0])
        camera = ParallelCamera(
            shot.axes,
            shot.centre + place @ shot.axes,
            0.5 * self.unit * side,
            SAMPLES_PER_PIXEL * side,
        )
        binding = self.plan.binding
        surface = project_surface(camera, shot.mesh, binding.rest.faces)
        red, green, blue, opacity = downsample(
            render_with_cage(surface, camera, binding.cage.move(shot.cage))
        )
        colours = np.stack([red, green, blue], axis=2)
        background = parse_colour(FILM_COLOURS["background"])
        mixed = background + opacity[..., None] * (colours - background)
        levels: Pixels = np.rint(255 * np.clip(mixed, 0, 1)).astype(np.uint8)
        return levels


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
