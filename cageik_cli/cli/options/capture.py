"""Options for clips from scanners and trackers."""

from typing import Any, Literal

import click

from cageik_cli.cli.options.common import usage_errors
from cageik_cli.cli.options.group import OptionGroup
from cageik_cli.solver.settings import AUTO_SMOOTHING, CaptureSettings


class PeriodType(click.ParamType):  # type: ignore[type-arg]  # not subscriptable before click 8.4
    """A period in seconds, or `auto`."""

    name = "period"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float | Literal["auto"]:
        """Parse the text."""
        if value == AUTO_SMOOTHING:
            return AUTO_SMOOTHING
        try:
            return float(str(value))
        except ValueError:
            self.fail(f"{value!r} is not a number of seconds, or {AUTO_SMOOTHING}", param, ctx)


def make_capture_settings(robust: bool, smooth: Any, fill_gaps: bool) -> CaptureSettings:
    """Make the settings; impossible values are wrong usage."""
    with usage_errors():
        return CaptureSettings(robust, smooth, fill_gaps)


CAPTURE_OPTIONS = OptionGroup(
    "capture",
    make_capture_settings,
    click.option(
        "--robust", is_flag=True, help="Reject vertices that are thrown away in some frames."
    ),
    click.option(
        "--smooth",
        type=PeriodType(),
        metavar=f"SECONDS|{AUTO_SMOOTHING}",
        help="Smooth the cages over time: halve motions of this period, or find it from the noise.",
    ),
    click.option(
        "--fill-gaps", is_flag=True, help="Fill frames without data from those around them."
    ),
)
