"""A film of a result: its pictures drawn one by one, and written as they are drawn."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from cageik_cli.report.film.moving_images import IMAGE_TYPES, Pixels
from cageik_cli.report.film.settings import FilmSettings
from cageik_cli.report.film.shots import FilmPlan, Shot
from cageik_cli.report.render.model_views import project_surface, render_with_cage
from cageik_cli.report.render.raster import ParallelCamera
from cageik_cli.report.render.shading import SAMPLES_PER_PIXEL, downsample, parse_colour
from cageik_cli.store.result import Result, load_binding
from cageik_cli.util.arrays import Floats, Integers, spread_evenly
from cageik_cli.util.outputs import atomic_file
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.threads import OrderedMap, count_processors

FILM_COLOURS = {"background": "#ffffff", "label": "#59626d"}
"""Of what is neither the model nor its cage."""

MAX_TILE_SIDE = 640
"""Pixels of a square that is drawn at once: larger pictures take no more memory."""

COLOUR_SAMPLES = 6
"""Pictures from which the colours of a GIF are chosen."""


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
        """Draw a shot, (h, w, 3)."""
        width, height = self.plan.settings.film_size
        pixels: Pixels = np.empty((height, width, 3), np.uint8)
        tiles = [-(-side // MAX_TILE_SIDE) for side in (width, height)]
        side = max(-(-width // tiles[0]), -(-height // tiles[1]))
        for top in range(0, height, side):
            for left in range(0, width, side):
                part = pixels[top : top + side, left : left + side]
                part[:] = self._draw_tile(shot, left, top, side)[: part.shape[0], : part.shape[1]]
        return _write_label(pixels, shot.label)

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


def _write_label(pixels: Pixels, label: str) -> Pixels:
    """Write a text into the lower left corner."""
    if not label:
        return pixels
    image = Image.fromarray(pixels)
    margin, size = 8, 13.0  # pixels
    place = (margin, image.height - margin)
    font = ImageFont.load_default(size)
    colour = FILM_COLOURS["label"]
    ImageDraw.Draw(image).text(place, label, colour, font, anchor="ls")
    return np.asarray(image)
