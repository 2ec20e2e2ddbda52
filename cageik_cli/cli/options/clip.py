"""Options on an animation that is read or written: which frames, and in what scene."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.command import HelpGroup, option
from cageik_cli.cli.options import PATH_TYPE, Decorator, OptionGroup, is_given
from cageik_cli.cli.options.types import FrameNumberType, FrameRangeType, PercentType, SceneType
from cageik_cli.formats.settings import (
    AUTO,
    DEFAULT_MORPHS,
    LAYOUTS,
    MAX_MORPHS,
    UP_AXES,
    ClipSettings,
    Gaps,
    MorphSettings,
    SceneHints,
)

layout_option = option(
    "--layout",
    type=click.Choice(LAYOUTS),
    help="Order of an array's axes: f frames, v vertices, x coordinates.  "
    "[default: found from their lengths]",
    group=HelpGroup.CLIP,
)


def make_exclude_option(typed: str) -> Decorator:
    """Make the option that leaves out parts; cageik batch has it under another name."""
    return option(
        typed,
        "exclude",
        metavar="PATTERN",
        multiple=True,
        help="Leave out the parts of a clip or a model whose path, or a name in it, matches this "
        "pattern, such as 'eye_?' or '/hero/props'; may be repeated.",
        group=HelpGroup.CLIP,
    )


exclude_option = make_exclude_option("--exclude")


def choose_gaps(allow_gaps: bool, close_gaps: bool) -> Gaps:
    """Return what is done about missing files; gaps cannot be both kept and closed."""
    if allow_gaps and close_gaps:
        raise click.UsageError("--allow-gaps and --close-gaps exclude each other; leave one out")
    return "keep" if allow_gaps else "close" if close_gaps else "refuse"


CLIP_MEMBERS = (
    option(
        "--frames",
        "selection",
        type=FrameRangeType(),
        default=":",
        metavar="FIRST-LAST",
        help="Take these frames only: 1020-1060, 1020-1060x2 (every second), 1020, 1020- (to the "
        "end); the slice A:B:STEP counts from 0.  [default: all]",
    ),
    layout_option,
    exclude_option,
    OptionGroup(
        "gaps",
        choose_gaps,
        option(
            "--allow-gaps",
            is_flag=True,
            help="Keep missing numbers of files as gaps in time, which are filled like skipped "
            "frames.",
        ),
        option(
            "--close-gaps",
            is_flag=True,
            help="Number the frames one after another, whatever numbers of files are missing.",
        ),
        group=HelpGroup.CLIP,
    ),
)

CLIP_OPTIONS = OptionGroup("clip", ClipSettings, *CLIP_MEMBERS)

rate_option = click.option(
    "--fps",
    type=float,
    help="Frames per second at which glTF is sampled.  [default: 24]",
)

SAMPLED_CLIP_OPTIONS = OptionGroup("clip", ClipSettings, *CLIP_MEMBERS, rate_option)

SCENE_OPTIONS = OptionGroup(
    "scene",
    SceneHints,
    option(
        "--fps",
        type=float,
        help="Frames per second; glTF is sampled at them.  [default: from the source, or 24]",
    ),
    option(
        "--start", type=float, help="Number of the first frame.  [default: from the source, or 1]"
    ),
    option(
        "--frame-step",
        type=float,
        help="From the number of a frame to that of the next.  [default: from the source, or 1]",
    ),
    option(
        "--up-axis",
        type=click.Choice(UP_AXES),
        help="Axis that points up.  [default: from the source, or Y]",
    ),
    option(
        "--metres-per-unit",
        type=float,
        help="Metres per unit of length.  [default: from the source, or 1]",
    ),
    group=HelpGroup.CLIP,
)


to_option = option(
    "--to",
    type=SceneType(),
    default="",
    help="Convert what is written to this unit (mm, cm, dm, m, km, in, ft) and up axis, such as "
    "m or cm,z.  [default: as the source]",
    group=HelpGroup.CLIP,
)


def make_given_option(what: str, over: str) -> Callable[[Any], Any]:
    """Make --from, for the options `what` beside `over`."""
    return option(
        "--from",
        "given_in",
        type=SceneType(),
        default="",
        help=f"Unit (mm, cm, dm, m, km, in, ft) and up axis of {what}, such as cm or m,z, which "
        f"are converted to those of {over}. Of several files, it is for those that state nothing."
        "  [default: what the files state]",
        group=HelpGroup.CLIP,
    )


def _refuse_two_rest_poses(ctx: click.Context, param: click.Parameter, value: Any) -> Any:
    if is_given("rest") and is_given("rest_frame"):
        raise click.UsageError("--rest and --rest-frame both give the rest pose; leave one out")
    return value


rest_option = option(
    "--rest",
    type=PATH_TYPE,
    callback=_refuse_two_rest_poses,
    help="Mesh of the rest pose.  [default: the first frame]",
)

rest_frame_option = option(
    "--rest-frame",
    type=FrameNumberType(),
    default="",
    callback=_refuse_two_rest_poses,
    metavar=f"N|{AUTO}",
    help="Number of the frame that is the rest pose, or auto: the frame in which the fewest parts "
    "touch.  [default: the first; with --cage, of the whole clip, whatever --frames takes]",
    group=HelpGroup.CLIP,
)

MORPH_MEMBERS = (
    option(
        "--morphs",
        "count",
        type=click.IntRange(2, MAX_MORPHS),
        help=f"Write at most this number of morph targets (.glb).  [default: "
        f"{DEFAULT_MORPHS}, or {MAX_MORPHS} with --tolerance]",
    ),
    option(
        "--tolerance",
        type=PercentType("a tolerance", "0.01%, of the diagonal"),
        help="Write as few morph targets as bring every vertex in every frame this near, in "
        "percent of the diagonal, such as 0.01%; fail if that is impossible (.glb). With "
        "--skeleton, leave out keys of joints as long as that holds.",
    ),
)


def make_morph_settings(tolerance: float | None, **others: Any) -> MorphSettings:
    """Make the settings of morph targets; a tolerance of 0 is wrong usage."""
    if tolerance == 0:
        raise click.UsageError(
            "--tolerance is 0, expected a percentage above zero, such as 0.01%: positions are in "
            "single precision"
        )
    return MorphSettings(tolerance=tolerance, **others)


MORPH_OPTIONS = OptionGroup("morphs", make_morph_settings, *MORPH_MEMBERS, group=HelpGroup.WRITTEN)


def check_morph_usage(options: str, is_given: bool, out: Path) -> None:
    """Refuse options of morph targets for another format as wrong usage."""
    if is_given and out.suffix.lower() != ".glb":
        raise click.UsageError(
            f"{options} apply to .glb files, and the output is {out}; leave them out, or write .glb"
        )
