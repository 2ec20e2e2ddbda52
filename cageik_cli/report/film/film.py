"""A film of a result, the clip or a turn around the rest pose, as GIF or WebP.

Pictures are drawn one by one, and Pillow writes them. Until the last is there, it keeps a byte per
pixel of those of a GIF, and those of a WebP as they are encoded.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

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
from cageik_cli.store.result import StoredAnimation, load_binding, read_poses
from cageik_cli.util.arrays import Floats, Integers, count_frames, spread_evenly
from cageik_cli.util.errors import SettingError
from cageik_cli.util.messages import say
from cageik_cli.util.outputs import atomic_file
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.threads import OrderedMap, count_processors

FILM_COLOURS = {"background": "#ffffff", "label": "#59626d"}
"""Of what is neither the model nor its cage."""

MAX_SHOT_BYTES = 64 << 20
"""Bytes of the meshes of a film that are in memory at a time."""

MAX_TILE_SIDE = 640
"""Pixels of a square that is drawn at once: larger pictures take no more memory."""

GIF_COLOURS = 127
"""Colours of a GIF, which are the same in all its pictures; one more stands for what stays."""

COLOUR_SAMPLES = 6
"""Pictures from which the colours of a GIF are chosen."""

MAX_GIF_PIXELS = 1 << 30
"""Pixels of all pictures of a GIF, each of which takes a byte of memory."""

WEBP_QUALITY = 75
"""Of the pictures of a WebP, up to 100: the thin lines of a cage stay clean."""

Pixels = NDArray[np.uint8]
"""(h, w, 3): red, green and blue."""


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


class Film:
    """The pictures of a film, which are drawn at one scale, and can be drawn several times.

    Parameters
    ----------
    result : StoredAnimation
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

    def __init__(self, result: StoredAnimation, binding: Binding, settings: FilmSettings) -> None:
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

    def fit(self) -> None:
        """Find the largest scale at which all that any shot shows is in the picture.

        That is the step from the centre of a shot to the middle of its picture, along the axes of
        the camera, and the size of a pixel, in units of the model.
        """
        margin, label_height = 0.03, 20  # share of the picture; pixels
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        drawn: Integers = np.unique(self.binding.rest.faces)
        for shot in self.shots():
            for points in (shot.mesh[drawn], shot.cage):
                seen = (points - shot.centre) @ shot.axes.T
                low, high = np.minimum(low, seen.min(axis=0)), np.maximum(high, seen.max(axis=0))
        width, height = self.settings.film_size
        room = (1 - 2 * margin) * np.array([width, height - label_height])
        self._unit = float(((high - low)[:2] / room).max()) or 1.0
        # The label is below the model.
        lift = np.array([0, -0.5 * label_height * self._unit, 0])
        self._offset = 0.5 * (low + high) + lift

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
        for block in read_poses(self.result, count * self._step):
            poses = block[:: self._step]
            yield from zip(reconstruct_frames(self.binding, poses), poses.cages, strict=True)

    def choose_colours(self) -> Image.Image:
        """Choose colours for all shots by some of them; return an image that has their palette."""
        chosen = set(spread_evenly(self.count, COLOUR_SAMPLES).tolist())
        shots = (shot for number, shot in enumerate(self.shots()) if number in chosen)
        samples = Image.fromarray(np.concatenate([self.draw(shot) for shot in shots]))
        return samples.quantize(GIF_COLOURS, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)

    def draw(self, shot: Shot) -> Pixels:
        """Draw a shot at the scale of `fit`, (h, w, 3), with its label in the lower left corner."""
        width, height = self.settings.film_size
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
        width, height = self.settings.film_size
        right, down = left + 0.5 * (side - width), top + 0.5 * (side - height)
        place = self._offset + self._unit * np.array([right, -down, 0])
        camera = ParallelCamera(
            shot.axes,
            shot.centre + place @ shot.axes,
            0.5 * self._unit * side,
            SAMPLES_PER_PIXEL * side,
        )
        binding = self.binding
        surface = project_surface(camera, shot.mesh, binding.rest.faces)
        red, green, blue, opacity = downsample(
            render_with_cage(surface, camera, binding.cage.move(shot.cage))
        )
        colours = np.stack([red, green, blue], axis=2)
        background = parse_colour(FILM_COLOURS["background"])
        mixed = background + opacity[..., None] * (colours - background)
        levels: Pixels = np.rint(255 * np.clip(mixed, 0, 1)).astype(np.uint8)
        return levels


class LaterPictures:
    """The pictures of a film after the first, which are drawn when Pillow asks for them.

    Pillow takes this for an image of several pictures, such as a file holds, and has one at a time.
    """

    def __init__(self, first: Image.Image, others: Iterator[Image.Image], count: int) -> None:
        self.n_frames = count
        self._shown, self._others = first, others

    def seek(self, number: int) -> None:
        """Go to the next picture."""
        if number == self.n_frames:
            raise EOFError
        self._shown = next(self._others)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._shown, name)


def write_film(
    result: StoredAnimation,
    path: Path,
    settings: FilmSettings,
    overwrite: bool,
    progress: ProgressListener,
) -> Film:
    """Write a film as GIF or WebP, as the name says; the same bytes for the same arguments.

    Raises
    ------
    SettingError
        When the result has no weights, or its clip is too long.
    OutputError
        When the file cannot be written.
    """
    binding = load_binding(result, "a film")
    film = Film(result, binding, settings)
    is_gif = path.suffix.lower() == ".gif"
    width, height = settings.film_size
    if is_gif and film.count * width * height > MAX_GIF_PIXELS:
        raise SettingError(
            f"{path}: {film.count} pictures of {width}x{height} pixels are too many for a "
            "GIF; " + say("choose a smaller `film_size=` or `film_seconds=`, or write .webp")
        )
    with progress.stage("film"):
        film.fit()
        palette = film.choose_colours() if is_gif else None
        # GIF has times in hundredths of a second.
        unit = 10 if is_gif else 1
        times = unit * np.array(film.list_times(1000 // unit))
        jobs = count_processors()

        def draw_all(drawn: Iterable[Pixels]) -> Iterator[Image.Image]:
            for number, pixels in enumerate(drawn):
                image = Image.fromarray(pixels)
                if palette is not None:
                    image = image.quantize(palette=palette, dither=Image.Dither.NONE)
                progress.update(number + 1, film.count)
                yield image

        with (
            atomic_file(path, overwrite) as file,
            OrderedMap(film.draw, film.shots(), jobs, jobs + 1) as drawn,
        ):
            pictures = draw_all(drawn)
            first = next(pictures)
            first.save(
                file,
                "GIF" if is_gif else "WEBP",
                save_all=True,
                append_images=[LaterPictures(first, pictures, film.count - 1)],
                duration=np.diff(times).tolist(),
                loop=0,
                optimize=True,
                quality=WEBP_QUALITY,
                method=4,
            )
    return film
