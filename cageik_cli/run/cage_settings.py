"""The settings of commands that build, repair or check a cage. This module imports no numerics."""

from dataclasses import MISSING, dataclass
from pathlib import Path

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.formats.settings import ClipSettings, RestFrame, SceneHints
from cageik_cli.inputs.settings import (
    CLIP,
    CommandSettings,
    declare_given_in,
    declare_overwrite,
    declare_rest,
    declare_rest_frame,
)
from cageik_cli.util.settings import declare_group, declare_setting, repeat_setting


@dataclass(frozen=True, slots=True)
class CageSettings(CommandSettings):
    """The model to build a cage around, and the file to write it to.

    Attributes
    ----------
    rest_frame : int or str, optional
        Which frame then: its index, or as text its number; or "auto", the one in which the
        least of the surface touches; the first if absent.
    """

    model: str = declare_setting(
        MISSING, "", option="MODEL", is_required=False, role="read as a clip"
    )
    output: Path = declare_setting(
        MISSING, "The cage, an .obj file.", option="-o/--output", role="written"
    )
    build: BuildSettings = declare_group(BuildSettings())
    rest: Path | None = declare_rest()
    rest_frame: RestFrame | None = declare_rest_frame(None)
    animation: tuple[str, ...] = declare_setting(
        (),
        "Choose the cage with the smallest error on these frames; may be repeated.",
        option="--for",
        metavar="FRAMES",
        role="read as a clip",
    )
    clip: ClipSettings = declare_group(ClipSettings(gaps="close"), CLIP | {"fps": {}})
    given_in: SceneHints = declare_given_in("--repair, --for, and --rest of a clip", "the model")
    overwrite: bool = declare_overwrite()
    jobs: int = 1


@dataclass(frozen=True, slots=True)
class RepairCageSettings(CommandSettings):
    """Which cage to repair, for which model, and where to write it."""

    cage: Path = declare_setting(
        MISSING,
        "Make this cage fit for the model instead, with as little change as possible.",
        option="--repair",
        metavar="CAGE",
        is_required=False,
        role="read",
    )
    model: Path = repeat_setting(CageSettings, "model", role="read")
    output: Path = repeat_setting(CageSettings, "output")
    given_in: SceneHints = repeat_setting(CageSettings, "given_in")
    overwrite: bool = declare_overwrite()


@dataclass(frozen=True, slots=True)
class CheckSettings(CommandSettings):
    """What to check.

    Attributes
    ----------
    rest_frame : int or str
        Which frame then: its index, or as text its number; or "auto", the one in which the
        least of the surface touches.
    """

    cage: Path = declare_setting(
        MISSING, "The cage to diagnose.  [required]", is_required=False, role="read"
    )
    frames: tuple[str, ...] = declare_setting((), "", option="FRAMES", role="read as a clip")
    rest: Path | None = declare_rest()
    rest_frame: RestFrame = declare_rest_frame(
        0, needs="frames", needs_message="{} needs {}; name them, or leave it out"
    )
    clip: ClipSettings = declare_group(ClipSettings(gaps="close"), CLIP | {"fps": {}})
    given_in: SceneHints = declare_given_in(
        "--cage and --rest", "the clip, or of --rest without one"
    )
    jobs: int = 1
