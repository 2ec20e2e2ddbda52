"""How an animation sits in a scene: what time and space its numbers mean."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from math import isfinite
from typing import Any

from cageik_cli.util.errors import InputError, SettingError

UP_AXES = ("Y", "Z")


@dataclass(frozen=True, slots=True)
class Scene:
    """Time and space of an animation, with what is usual where nobody says.

    Attributes
    ----------
    fps : float
        Frames a second.
    start : float
        Number of the first frame on the scene's time line.
    up_axis : str
        One of `UP_AXES`.
    metres_per_unit : float
        Length of a file unit, metres.

    Raises
    ------
    InputError
        When one of them cannot be.
    """

    fps: float = 24.0
    start: float = 1.0
    up_axis: str = "Y"
    metres_per_unit: float = 1.0

    def __post_init__(self) -> None:
        for name, value in (
            ("frames a second", self.fps),
            ("metres a unit", self.metres_per_unit),
        ):
            if not 0 < value < float("inf"):
                raise SettingError(f"{value:g} {name}, expected a number above zero")
        if not isfinite(self.start):
            raise SettingError(f"the first frame's number is {self.start}, expected a finite one")
        if self.up_axis not in UP_AXES:
            raise SettingError(f"the up axis is {self.up_axis}, expected {' or '.join(UP_AXES)}")


@dataclass(frozen=True, slots=True)
class SceneHints:
    """What somebody says of a scene; None where they say nothing. As in `Scene` otherwise."""

    fps: float | None = None
    start: float | None = None
    up_axis: str | None = None
    metres_per_unit: float | None = None

    def __post_init__(self) -> None:
        self.override(Scene())

    def override(self, scene: Scene) -> Scene:
        """`scene`, but for what is said here."""
        said = {name: getattr(self, name) for name in self.__slots__}
        return replace(scene, **{name: value for name, value in said.items() if value is not None})

    def restrict_to_frames(self, frames: range) -> "SceneHints":
        """What is said of those frames of the clip alone.

        Every second frame has half the frames a second, so that the motion keeps its speed.
        """
        fps = None if self.fps is None else self.fps / frames.step
        start = None if self.start is None else self.start + frames.start
        return replace(self, fps=fps, start=start)

    @property
    def describe(self) -> str:
        """What is said, in a line; empty if nothing is."""
        said = (
            self.fps is not None and f"{self.fps:g} frames a second",
            self.start is not None and f"from frame {self.start:g}",
            self.up_axis is not None and f"{self.up_axis} up",
            self.metres_per_unit is not None and f"{self.metres_per_unit:g} m a unit",
        )
        return ", ".join(word for word in said if word)


def parse_scene_metadata(metadata: Mapping[str, Any]) -> tuple[SceneHints, tuple[str, ...]]:
    """The hints among the values that a file has under their names, and what is wrong with others.

    What is no single number (text for the axis) is somebody else's and passed by.
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
            notes.append(f"`{field.name}` is passed by: {error}")
    return hints, tuple(notes)
