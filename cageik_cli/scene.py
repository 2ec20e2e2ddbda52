"""How an animation sits in a scene: what time and space its numbers mean."""

from dataclasses import dataclass, replace
from math import isfinite

from cageik_cli.errors import InputError

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
                raise InputError(f"{value:g} {name}, expected a number above zero")
        if not isfinite(self.start):
            raise InputError(f"the first frame's number is {self.start}, expected a finite one")
        if self.up_axis not in UP_AXES:
            raise InputError(f"the up axis is {self.up_axis}, expected {' or '.join(UP_AXES)}")


@dataclass(frozen=True, slots=True)
class SceneHints:
    """What somebody says of a scene; None where they say nothing. As in `Scene` otherwise."""

    fps: float | None = None
    start: float | None = None
    up_axis: str | None = None
    metres_per_unit: float | None = None

    def __post_init__(self) -> None:
        self.applied(Scene())

    def applied(self, scene: Scene) -> Scene:
        """`scene`, but for what is said here."""
        said = {name: getattr(self, name) for name in self.__slots__}
        return replace(scene, **{name: value for name, value in said.items() if value is not None})

    def chosen(self, frames: range) -> "SceneHints":
        """What is said of those frames of the clip alone.

        Every second frame has half the frames a second, so that the motion keeps its speed.
        """
        fps = None if self.fps is None else self.fps / frames.step
        start = None if self.start is None else self.start + frames.start
        return replace(self, fps=fps, start=start)
