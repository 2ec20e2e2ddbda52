"""The pictures of a film of a result: the clip, or a turn around the rest pose."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from cageik_cli.method.weights.binding import Binding, reconstruct_frames
from cageik_cli.report.film.settings import (
    DEFAULT_TURN_SECONDS,
    HALF_VIEW,
    MAX_FILM_RATE,
    MAX_FILM_SECONDS,
    TURN_RATE,
    FilmSettings,
    FilmView,
)
from cageik_cli.report.render.model_views import (
    VIEW_TILT,
    VIEW_TURN,
    overlay_cage,
    project_surface,
    render_model,
    view_axes,
)
from cageik_cli.report.render.raster import Camera, ParallelCamera, PerspectiveCamera
from cageik_cli.report.render.shading import SAMPLES_PER_PIXEL, downsample, parse_colour
from cageik_cli.store.result import StoredAnimation, read_poses
from cageik_cli.util.arrays import Floats, count_frames, spread_evenly
from cageik_cli.util.errors import SettingError
from cageik_cli.util.messages import say

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
        What the camera looks at, goes around, or goes with.
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
    cut : int
        Number of pictures beyond whose edges something is, as `fit` finds.

    Raises
    ------
    SettingError
        When the whole clip is asked for and is too long.
    """

    def __init__(self, result: StoredAnimation, binding: Binding, settings: FilmSettings) -> None:
        self.result, self.binding, self.settings = result, binding, settings
        self.cut, self._diagonal = 0, result.rest.diagonal or 1.0
        self._view = settings.view or FilmView(VIEW_TURN, VIEW_TILT)
        self._follows = settings.film_follow or self._view.follows
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
        """Find the scale; of a view that is at no distance, the largest that shows all.

        That is the step from the centre of a shot to the middle of its picture, along the axes of
        the camera, and the size of a pixel there, in units of the model.
        """
        if self._view.distance is None:
            self._fit_all()
            return
        span = 2 * math.tan(math.radians(HALF_VIEW)) * self._view.distance
        self._unit = span * self._diagonal / min(self.settings.film_size)
        self._offset = np.zeros(3)
        size = np.array(self.settings.film_size)
        for shot in self.shots():
            camera = self._place_camera(shot, 0, 0, 1)
            for points in self._drawn_points(shot):
                seen = camera.project(points)[:, :2] / SAMPLES_PER_PIXEL
                if not ((seen >= 0) & (seen <= size)).all():
                    self.cut += 1
                    break

    def _fit_all(self) -> None:
        margin, label_height = 0.03, 20  # share of the picture; pixels
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for shot in self.shots():
            for points in self._drawn_points(shot):
                seen = (points - shot.centre) @ shot.axes.T
                low, high = np.minimum(low, seen.min(axis=0)), np.maximum(high, seen.max(axis=0))
        width, height = self.settings.film_size
        room = (1 - 2 * margin) * np.array([width, height - label_height])
        self._unit = float(((high - low)[:2] / room).max()) or 1.0
        # The label is below the model.
        lift = np.array([0, -0.5 * label_height * self._unit, 0])
        self._offset = 0.5 * (low + high) + lift

    def _drawn_points(self, shot: Shot) -> Iterator[Floats]:
        """Yield the points of all that a shot shows: vertices in no face may be far away."""
        yield shot.mesh[np.unique(self.binding.rest.faces)]
        if not self.settings.film_no_cage:
            yield shot.cage

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
        if self._view.distance is not None:
            centre = self._find_target()
        for number in range(self.count):
            turn = self._view.turn + 360 * number / self.count
            axes = view_axes(self.result.scene.up_axis, turn, self._view.tilt)
            yield Shot(rest, cage, axes, centre, "")

    def _play(self) -> Iterator[Shot]:
        result, view = self.result, self._view
        axes = view_axes(result.scene.up_axis, view.turn, view.tilt)
        timeline = result.scene.make_timeline(len(result.frames))
        # The mean of the cage moves evenly; the middle of a box around it would jerk.
        start = np.zeros(3)
        if view.distance is not None:
            start = self._find_target()
            if self._follows:
                start = start - self.binding.cage.vertices.mean(axis=0)
        for number, (mesh, cage) in enumerate(islice(self._rebuild(), self.count)):
            centre = start + cage.mean(axis=0) if self._follows else start
            label = f"frame {timeline.number_frame(number * self._step)}"
            yield Shot(mesh, cage, axes, centre, label)

    def _find_target(self) -> Floats:
        """Return what a view at a distance looks at, in the units of the model, (3,)."""
        middle: Floats = self.binding.cage.vertices.mean(axis=0)
        return middle + self._diagonal * np.array(self._view.place)

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
        camera, binding = self._place_camera(shot, left, top, side), self.binding
        surface = project_surface(camera, shot.mesh, binding.rest.faces)
        picture = render_model(surface)
        if not self.settings.film_no_cage:
            picture = overlay_cage(picture, camera, surface, binding.cage.move(shot.cage))
        red, green, blue, opacity = downsample(picture)
        colours = np.stack([red, green, blue], axis=2)
        background = parse_colour(FILM_COLOURS["background"])
        mixed = background + opacity[..., None] * (colours - background)
        levels: Pixels = np.rint(255 * np.clip(mixed, 0, 1)).astype(np.uint8)
        return levels

    def _place_camera(self, shot: Shot, left: int, top: int, side: int) -> Camera:
        """Return the camera of a square whose upper left corner is at a pixel."""
        width, height = self.settings.film_size
        samples, view = SAMPLES_PER_PIXEL * side, self._view
        if view.distance is not None:
            middle = [SAMPLES_PER_PIXEL * k for k in (0.5 * width - left, 0.5 * height - top)]
            distance = view.distance * self._diagonal
            return PerspectiveCamera(
                shot.axes,
                shot.centre,
                distance,
                self._unit / SAMPLES_PER_PIXEL,
                (middle[0], middle[1]),
                samples,
            )
        right, down = left + 0.5 * (side - width), top + 0.5 * (side - height)
        place = self._offset + self._unit * np.array([right, -down, 0])
        extent = 0.5 * self._unit * side
        return ParallelCamera(shot.axes, shot.centre + place @ shot.axes, extent, samples)
