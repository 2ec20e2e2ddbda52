"""Options of every command that reads or writes an animation: which frames, in what scene."""

import re
from collections.abc import Callable
from typing import Any, TypeVar

import click

from cageik_cli.util.errors import CageikError

Command = TypeVar("Command", bound=Callable[..., Any])

# The reader's own words, which would take a second to import; a test compares them.
LAYOUTS = ("fvx", "vxf", "fxv")

UP_AXES = ("Y", "Z")


class FrameRangeType(click.ParamType):  # type: ignore[type-arg]  # not subscriptable before click 8.4
    """Frames A to B, B left out, every STEP-th: A:B:STEP, each of which may be left out."""

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
                f"{value!r} does not choose frames; expected A:B or A:B:STEP, such as 10:20, "
                "counted from 0, B left out",
                param,
                ctx,
            )
        return slice(*(None if bound is None else int(bound) for bound in match.groups()))


layout_option = click.option(
    "--layout",
    type=click.Choice(LAYOUTS),
    help="Order of an array's axes: f frames, v vertices, x coordinates.  "
    "[default: by their lengths]",
)


def clip_options(command: Command) -> Command:
    """--frames, --layout and --allow-gaps: how a clip is taken."""
    for option in (
        click.option(
            "--allow-gaps", is_flag=True, help="Take frames although a number is missing."
        ),
        layout_option,
        click.option(
            "--frames",
            "selection",
            type=FrameRangeType(),
            default=":",
            help="Only frames A:B:STEP of the clip, from 0, B left out.  [default: all]",
        ),
    ):
        command = option(command)
    return command


def scene_options(command: Command) -> Command:
    """--fps, --start, --up-axis and --metres-per-unit: time and space, if not as the source's."""
    for option in (
        click.option(
            "--metres-per-unit", type=float, help="Length of a unit.  [default: the source's, or 1]"
        ),
        click.option(
            "--up-axis",
            type=click.Choice(UP_AXES),
            help="Which axis is up.  [default: the source's, or Y]",
        ),
        click.option(
            "--start", type=float, help="Number of the first frame.  [default: the source's, or 1]"
        ),
        click.option("--fps", type=float, help="Frames a second.  [default: the source's, or 24]"),
    ):
        command = option(command)
    return command


def pop_clip_settings(options: dict[str, Any]) -> Any:
    """Take the clip's options out of `options`, as settings."""
    from cageik_cli.formats.base.sequence import ClipSettings

    return ClipSettings(*(options.pop(name) for name in ("selection", "layout", "allow_gaps")))


def pop_scene_hints(options: dict[str, Any]) -> Any:
    """Take the scene's options out of `options`, as hints.

    Raises
    ------
    click.UsageError
        When a value cannot be.
    """
    from cageik_cli.formats.scene import SceneHints

    names = ("fps", "start", "up_axis", "metres_per_unit")
    values = [options.pop(name) for name in names]
    try:
        return SceneHints(*values)
    except CageikError as error:
        raise click.UsageError(str(error)) from error
