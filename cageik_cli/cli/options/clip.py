"""Options on an animation that is read or written: which frames, and in what scene."""

import re
from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.options.common import PATH_TYPE, usage_errors
from cageik_cli.cli.options.group import OptionGroup
from cageik_cli.formats.settings import (
    AUTO,
    LAYOUTS,
    UP_AXES,
    ClipSettings,
    Gaps,
    RestFrame,
    SceneHints,
)


class FrameRangeType(click.ParamType):  # type: ignore[type-arg]  # not subscriptable before click 8.4
    """Frames A to B, without B, every STEP-th: A:B:STEP, each of which may be left out."""

    name = "a:b:step"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> slice:
        """Parse the text."""
        if isinstance(value, slice):
            return value
        match = re.fullmatch(r"(-?\d{1,9})?:(-?\d{1,9})?(?::(\d{1,9})?)?", str(value).strip())
        if not match or (match[3] and int(match[3]) == 0):
            self.fail(
                f"{value!r} is not a range of frames; expected A:B or A:B:STEP, such as 10:20 "
                "for frames 10 to 19, counted from 0",
                param,
                ctx,
            )
        return slice(*(None if bound is None else int(bound) for bound in match.groups()))


layout_option = click.option(
    "--layout",
    type=click.Choice(LAYOUTS),
    help="Order of an array's axes: f frames, v vertices, x coordinates.  "
    "[default: found from their lengths]",
)


def make_clip_settings(
    selection: slice, layout: str | None, allow_gaps: bool, close_gaps: bool
) -> ClipSettings:
    """Make the record of how a clip is read; gaps cannot be both kept and closed."""
    if allow_gaps and close_gaps:
        raise click.UsageError("--allow-gaps and --close-gaps exclude each other; leave one out")
    gaps: Gaps = "keep" if allow_gaps else "close" if close_gaps else "refuse"
    return ClipSettings(selection, layout, gaps)


CLIP_OPTIONS = OptionGroup(
    "clip",
    make_clip_settings,
    click.option(
        "--frames",
        "selection",
        type=FrameRangeType(),
        default=":",
        help="Take frames A:B:STEP only, counted from 0, without B.  [default: all]",
    ),
    layout_option,
    click.option(
        "--allow-gaps",
        is_flag=True,
        help="Keep missing numbers of files as gaps in time, which are filled like skipped frames.",
    ),
    click.option(
        "--close-gaps",
        is_flag=True,
        help="Number the frames one after another, whatever numbers of files are missing.",
    ),
)


def make_scene_hints(
    fps: float | None,
    start: float | None,
    frame_step: float | None,
    up_axis: str | None,
    metres_per_unit: float | None,
) -> SceneHints:
    """Make the scene of what was typed; impossible values are wrong usage."""
    with usage_errors():
        return SceneHints(fps, start, up_axis, metres_per_unit, frame_step)


SCENE_OPTIONS = OptionGroup(
    "scene",
    make_scene_hints,
    click.option("--fps", type=float, help="Frames per second.  [default: from the source, or 24]"),
    click.option(
        "--start", type=float, help="Number of the first frame.  [default: from the source, or 1]"
    ),
    click.option(
        "--frame-step",
        type=float,
        help="From the number of a frame to that of the next.  [default: from the source, or 1]",
    ),
    click.option(
        "--up-axis",
        type=click.Choice(UP_AXES),
        help="Axis that points up.  [default: from the source, or Y]",
    ),
    click.option(
        "--metres-per-unit",
        type=float,
        help="Metres per unit of length.  [default: from the source, or 1]",
    ),
)

rest_option = click.option(
    "--rest", type=PATH_TYPE, help="Mesh of the rest pose.  [default: the first frame]"
)


class RestFrameType(click.ParamType):  # type: ignore[type-arg]  # as above
    """The number of a frame, or `auto`."""

    name = "rest frame"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> RestFrame:
        """Parse the text."""
        if value == AUTO:
            return AUTO
        if not re.fullmatch(r"-?\d{1,9}", str(value).strip()):
            self.fail(f"{value!r} is not the number of a frame, or {AUTO}", param, ctx)
        return int(value)


rest_frame_option = click.option(
    "--rest-frame",
    type=RestFrameType(),
    metavar=f"K|{AUTO}",
    help="Number of the frame that is the rest pose, from 0, or auto: the frame in which the "
    "fewest parts touch.",
)


def choose_rest_frame(rest: Path | None, rest_frame: RestFrame | None) -> RestFrame:
    """Return the frame that is the rest pose, if no file is.

    Raises
    ------
    click.UsageError
        When both are given.
    """
    if rest is not None and rest_frame is not None:
        raise click.UsageError("--rest and --rest-frame both give the rest pose; leave one out")
    return rest_frame or 0
