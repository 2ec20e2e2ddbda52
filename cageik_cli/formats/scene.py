"""Scene settings of an animation: frame rate, frame numbers, up axis and unit of length."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from math import isfinite
from typing import Any

from cageik_cli.util.errors import InputError, SettingError

UP_AXES = ("Y", "Z")


@dataclass(frozen=True, slots=True)
class Scene:
    """Frame rate, frame numbers, up axis and unit of an animation, with the usual defaults.

    Frame k of the animation has the number start + k frame_step on the timeline, and is at that
    number / fps seconds.

    Attributes
    ----------
    fps : float
        Frames per second.
    start : float
        Number of the first frame on the timeline of the scene.
    up_axis : str
        One of `UP_AXES`.
    metres_per_unit : float
        Length of a file unit, metres.
    frame_step : float
        From the number of a frame to that of the next.

    Raises
    ------
    InputError
        When a value is not possible.
    """

    fps: float = 24.0
    start: float = 1.0
    up_axis: str = "Y"
    metres_per_unit: float = 1.0
    frame_step: float = 1.0

    def __post_init__(self) -> None:
        for name, value in (
            ("frames per second", self.fps),
            ("metres per unit", self.metres_per_unit),
            ("as the step of frame numbers", self.frame_step),
        ):
            if not 0 < value < float("inf"):
                raise SettingError(f"{value:g} {name}, expected a number above zero")
        if not isfinite(self.start):
            raise SettingError(
                f"the number of the first frame is {self.start}, expected a finite number"
            )
        if self.up_axis not in UP_AXES:
            raise SettingError(f"the up axis is {self.up_axis}, expected {' or '.join(UP_AXES)}")

    def frame_number(self, index: int) -> float:
        """Return the number of a frame on the timeline; `index` counts frames from 0."""
        return self.start + index * self.frame_step


@dataclass(frozen=True, slots=True)
class SceneHints:
    """The scene settings that a file or a user gives; None where they give none. See `Scene`."""

    fps: float | None = None
    start: float | None = None
    up_axis: str | None = None
    metres_per_unit: float | None = None
    frame_step: float | None = None

    def __post_init__(self) -> None:
        self.override(Scene())

    def override(self, scene: Scene) -> Scene:
        """Return `scene` with the settings that are given here."""
        given = {name: getattr(self, name) for name in self.__slots__}
        return replace(scene, **{name: value for name, value in given.items() if value is not None})

    def restrict_to_frames(self, frames: range) -> "SceneHints":
        """Return the settings of some frames of the clip, which keep their numbers."""
        whole = self.override(Scene())
        chosen = self
        if frames.start != 0:
            chosen = replace(chosen, start=whole.frame_number(frames.start))
        if frames.step != 1:
            chosen = replace(chosen, frame_step=whole.frame_step * frames.step)
        return chosen

    @property
    def description(self) -> str:
        """The settings on one line; empty if there are none."""
        given = (
            self.fps is not None and f"{self.fps:g} frames per second",
            self.start is not None and f"from frame {self.start:.10g}",
            self.frame_step not in (None, 1) and f"in steps of {self.frame_step:.10g}",
            self.up_axis is not None and f"{self.up_axis} up",
            self.metres_per_unit is not None and f"{self.metres_per_unit:g} m per unit",
        )
        return ", ".join(words for words in given if words)


MAX_FRAME_STEP = 10
"""Largest step of frame numbers that is found from times alone."""


def find_frame_step(start: float, tolerance: float) -> float | None:
    """Find the smallest step for which the number of the first frame is whole; None for 1.

    Formats that state times leave open whether a sample per 1/12 s is every second frame at 24
    frames per second. It is if the clip starts between two frames at 12.

    Parameters
    ----------
    start : float
        The time of the first frame, in steps from one sample to the next.
    tolerance : float
        Of the start.
    """
    for step in range(1, MAX_FRAME_STEP + 1):
        if abs(step * start - round(step * start)) <= step * tolerance:
            return float(step) if step > 1 else None
    return None


def parse_scene_metadata(metadata: Mapping[str, Any]) -> tuple[SceneHints, tuple[str, ...]]:
    """Return the scene settings in the metadata of a file, and notes on those that are ignored.

    A value that is not a single number (text for the axis) has another meaning and is skipped.
    """
    import numpy as np  # here, as the command line imports the settings and no numerics

    hints, notes = SceneHints(), []
    for field in fields(SceneHints):
        value = np.asarray(metadata.get(field.name))
        if value.shape != () or value.dtype.kind not in ("U" if field.name == "up_axis" else "fiu"):
            continue
        try:
            plain: Any = str(value) if field.name == "up_axis" else float(value)
            hints = replace(hints, **{field.name: plain})
        except InputError as error:
            notes.append(f"ignored `{field.name}`: {error}")
    return hints, tuple(notes)
