"""What a film shows, picture by picture: the clip, or a turn around the rest pose."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from cageik_cli.method.weights.binding import Binding, reconstruct_frames
from cageik_cli.report.film.settings import (
    DEFAULT_TURN_SECONDS,
    MAX_FILM_RATE,
    MAX_FILM_SECONDS,
    TURN_RATE,
    FilmSettings,
)
from cageik_cli.report.render.model_views import VIEW_TURN, view_axes
from cageik_cli.store.result import Result, read_cages, read_rotations
from cageik_cli.util.arrays import Floats, count_frames
from cageik_cli.util.errors import SettingError

MAX_SHOT_BYTES = 64 << 20
"""Bytes of the meshes of a film that are in memory at a time."""


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
                f"{result.path}: plays {len(result.frames) / fps:.0f} s, which is too long for a "
                f"film (expected at most {MAX_FILM_SECONDS:g} s); give its first seconds with "
                "`film_seconds=`"
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
