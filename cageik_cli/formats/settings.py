"""Scene settings of an animation: frame rate, frame numbers, up axis and unit of length."""

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, replace
from math import isfinite
from typing import Any, Final, Literal

from cageik_cli.formats.timeline import FrameRange, Timeline, check_frames
from cageik_cli.util.errors import InputError, SettingError
from cageik_cli.util.settings import HelpGroup, check_settings, declare_setting
from cageik_cli.util.units import UNIT_LENGTHS, spell_unit

UP_AXES = ("Y", "Z")

JOINT_MOTIONS = ("turn", "translate")
"""How the joints of a skeleton move: they also turn, as normals do with them, or they do not."""

TEXTURES = ("png", "exr")
"""Formats of the images of vertex animation textures."""

ROOT_MOTIONS = ("keep", "extract")
"""How the root of a skeleton moves: with the whole body, or along the ground."""

MAX_FRAME_STEP = 10
"""Frames from one sample of a clip to the next, at most, where times leave them open."""

LAYOUTS = ("fvx", "vxf", "fxv")
"""Orders of an array's axes: f frames, v vertices, x coordinates."""

AUTO: Final = "auto"
"""As the number of the rest pose: the frame in which the least of the surface touches."""

Gaps = Literal["refuse", "keep", "close"]
"""What is done with missing numbers of files: refused, kept in time, or closed."""

RestFrame = int | str
"""Which frame is the rest pose: its index from 0; or as text its number, or `AUTO`."""

GLTF_RATE_KEY = "cageik_rate"
"""Where animations in glTF, which has no frame rate, state it: frames per second, and the step of
frame numbers."""

DEFAULT_MORPHS = 60
"""Morph targets at most, where neither their number nor a tolerance is given."""

MAX_MORPHS = 256
"""Morph targets at most: all that WebGL 2 guarantees room for, as layers of a texture."""


MAX_SCENE_NUMBER = 1e50
"""Numbers of a scene up to it, and from its inverse on, multiply and divide without overflow."""


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
            if not value > 0:
                raise SettingError(f"{value:g} {name}, expected a number above zero")
            if not 1 / MAX_SCENE_NUMBER <= value <= MAX_SCENE_NUMBER:
                raise SettingError(
                    f"{value:g} {name}, expected {1 / MAX_SCENE_NUMBER:g} to {MAX_SCENE_NUMBER:g}"
                )
        if not isfinite(self.start):
            raise SettingError(
                f"the number of the first frame is {self.start}, expected a finite number"
            )
        if abs(self.start) > MAX_SCENE_NUMBER:
            raise SettingError(
                f"the number of the first frame is {self.start:g}, expected one up to "
                f"{MAX_SCENE_NUMBER:g}"
            )
        if self.up_axis not in UP_AXES:
            raise SettingError(f"the up axis is {self.up_axis}, expected {' or '.join(UP_AXES)}")

    @property
    def space(self) -> "SceneHints":
        """The unit and the up axis alone."""
        return SceneHints(up_axis=self.up_axis, metres_per_unit=self.metres_per_unit)

    def frame_number(self, index: int) -> float:
        """Return the number of a frame on the timeline; `index` counts frames from 0."""
        return self.start + index * self.frame_step

    def make_timeline(self, count: int) -> Timeline:
        """Return the numbers of `count` frames."""
        return Timeline(count, self.start, self.frame_step)


@dataclass(frozen=True, slots=True)
class SceneHints:
    """The scene settings that a file or a user gives; None where they give none. See `Scene`."""

    fps: float | None = declare_setting(
        None,
        "Frames per second; glTF, and keys of Alembic, are sampled at them.",
        unset="from the source, or 24",
        group=HelpGroup.CLIP,
    )
    start: float | None = declare_setting(
        None, "Number of the first frame.", unset="from the source, or 1", group=HelpGroup.CLIP
    )
    up_axis: str | None = declare_setting(
        None,
        "Axis that points up.",
        unset="from the source, or Y",
        choices=UP_AXES,
        group=HelpGroup.CLIP,
    )
    metres_per_unit: float | None = declare_setting(
        None,
        "Metres per unit of length.",
        unset="from the source, or 1",
        group=HelpGroup.CLIP,
    )
    frame_step: float | None = declare_setting(
        None,
        "From the number of a frame to that of the next.",
        unset="from the source, or 1",
        group=HelpGroup.CLIP,
    )

    def __post_init__(self) -> None:
        check_settings(self)
        self.override(Scene())

    def override(self, scene: Scene) -> Scene:
        """Return `scene` with the settings that are given here."""
        given = {name: getattr(self, name) for name in self.__slots__}
        return replace(scene, **{name: value for name, value in given.items() if value is not None})

    def over(self, others: "SceneHints") -> "SceneHints":
        """Return what is given here, and what is not as others give it."""
        given = {name: getattr(self, name) for name in self.__slots__}
        return replace(others, **{k: value for k, value in given.items() if value is not None})

    def restrict_to_frames(self, frames: range) -> "SceneHints":
        """Return the settings of some frames of the clip, which keep their numbers."""
        whole = self.override(Scene())
        chosen = self
        if frames.start != 0:
            chosen = replace(chosen, start=whole.frame_number(frames.start))
        if frames.step != 1:
            chosen = replace(chosen, frame_step=whole.frame_step * frames.step)
        return chosen

    @staticmethod
    def parse(text: str) -> "SceneHints":
        """Return the unit and the up axis that a text states, such as `cm` or `m,z`.

        Raises
        ------
        SettingError
        """
        name, comma, axis = (part.strip() for part in text.partition(","))
        length = UNIT_LENGTHS.get(name.lower())
        try:
            length = float(name) if length is None else length
            axes = axis.upper() if comma else None
            return SceneHints(up_axis=axes, metres_per_unit=length)
        except (ValueError, SettingError):
            raise SettingError(
                f"`{text}` is not a unit, or a unit and an up axis, expected "
                f"{', '.join(UNIT_LENGTHS)} or a number of metres; then perhaps ,y or ,z"
            ) from None

    @property
    def option_text(self) -> str:
        """The unit, if there is one, and the up axis as `parse` reads them."""
        unit = "" if self.metres_per_unit is None else spell_unit(self.metres_per_unit)
        return unit if self.up_axis is None else f"{unit},{self.up_axis.lower()}"

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


def find_frame_step(start: float, tolerance: float) -> float | None:
    """Find the smallest step for which the number of the first frame is whole; None for 1.

    Formats that state times leave open whether a sample per 1/12 s is every second frame at 24
    frames per second. It is if the clip starts between two frames at 12. `start` is the time of the
    first frame, in steps from one sample to the next, and right to the tolerance.
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
    for name in SceneHints.__slots__:
        value = np.asarray(metadata.get(name))
        if value.shape != () or value.dtype.kind not in ("U" if name == "up_axis" else "fiu"):
            continue
        try:
            plain: Any = str(value) if name == "up_axis" else float(value)
            hints = replace(hints, **{name: plain})
        except InputError as error:
            notes.append(f"ignored `{name}`: {error}")
    return hints, tuple(notes)


@dataclass(frozen=True, slots=True)
class ClipSettings:
    """Which frames of a clip to take, and how to read them.

    Attributes
    ----------
    selection : slice or FrameRange
        Which of its frames, by index or by number; the step is above zero.
    layout : str, optional
        The order of an array's axes, one of `LAYOUTS`; found from their lengths if absent.
    gaps : {"refuse", "keep", "close"}
        What is done when numbers of files are missing. They are refused; or kept, as frames
        without files; or closed, so that the frames follow one another.
    missing : bool
        Take vertices whose position is not a number as missing.
    exclude : tuple of str
        Patterns of the parts that are left out: of their paths, of a path above them, or of a name
        in it.
    fps : float, optional
        Frames per second of a clip that is sampled, as its file states no rate.
    """

    selection: slice | FrameRange = declare_setting(
        MISSING,
        "Take these frames only: 1020-1060, 1020-1060x2 (every second), 1020, 1020- (to the end); "
        "the slice A:B:STEP counts from 0.",
        factory=lambda: slice(None),
        option="--frames",
        kind="frames",
        typed=":",
        unset="all",
        metavar="FIRST-LAST",
    )
    layout: str | None = declare_setting(
        None,
        "Order of an array's axes: f frames, v vertices, x coordinates.",
        unset="found from their lengths",
        choices=LAYOUTS,
        group=HelpGroup.CLIP,
    )
    gaps: Gaps = declare_setting(
        "refuse",
        "",
        flags={
            "keep": (
                "--allow-gaps",
                "Keep missing numbers of files as gaps in time, which are filled like skipped "
                "frames.",
            ),
            "close": (
                "--close-gaps",
                "Number the frames one after another, whatever numbers of files are missing.",
            ),
        },
        group=HelpGroup.CLIP,
    )
    missing: bool = declare_setting(
        False,
        "Take vertices whose position is nan as missing data.",
        name="missing",
        meaning="take vertices whose position is not a number as missing",
        is_recorded_unset=False,
        group=HelpGroup.CAPTURED,
    )
    exclude: tuple[str, ...] = declare_setting(
        (),
        "Leave out the parts of a clip or a model whose path, or a name in it, matches this "
        "pattern, such as 'eye_?' or '/hero/props'; may be repeated.",
        name="exclude",
        meaning="patterns of the parts that are left out",
        is_recorded_unset=False,
        metavar="PATTERN",
        group=HelpGroup.CLIP,
    )
    fps: float | None = declare_setting(
        None,
        "Frames per second at which glTF, and keys of Alembic, are sampled.",
        unset="24",
        group=HelpGroup.RUNNING,
    )

    def __post_init__(self) -> None:
        check_frames(self.selection)
        check_settings(self)
        SceneHints(fps=self.fps)  # which checks it


@dataclass(frozen=True, slots=True)
class MorphSettings:
    """How a file of morph targets follows the frames.

    Attributes
    ----------
    morphs : int, optional
        Targets at most; `MAX_MORPHS` with a tolerance, else `DEFAULT_MORPHS`, if absent.
    tolerance : float, optional
        Largest distance of a vertex from its place in a frame, percent of the diagonal of the rest
        pose.
    has_normals : bool
        Write normals, which morph too.
    """

    morphs: int | None = declare_setting(
        None,
        "Write at most this number of morph targets (.glb).",
        unset=f"{DEFAULT_MORPHS}, or {MAX_MORPHS} with --tolerance",
        minimum=2,
        maximum=MAX_MORPHS,
        group=HelpGroup.WRITTEN,
    )
    tolerance: float | None = declare_setting(
        None,
        "Write as few morph targets as bring every vertex in every frame this near, in "
        "percent of the diagonal, such as 0.01%; fail if that is impossible (.glb). With "
        "--skeleton, leave out keys of joints as long as that holds.",
        kind="tolerance",
        above=0,
        refusal="`tolerance=` is {value:g}, expected a percentage above zero, such as 0.01%: "
        "positions are in single precision",
        group=HelpGroup.WRITTEN,
    )
    has_normals: bool = declare_setting(
        False,
        "Leave out normals: half the size, and programs show facets (.glb).",
        option="--flat",
        is_off=True,
        group=HelpGroup.WRITTEN,
    )

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def limit(self) -> int:
        """Targets at most."""
        if self.morphs is not None:
            return self.morphs
        return DEFAULT_MORPHS if self.tolerance is None else MAX_MORPHS
