"""Options of every command that judges results: what they are to keep."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any, TypeVar

import click

from cageik_cli.cli.options.common import PATH_TYPE

Command = TypeVar("Command", bound=Callable[..., Any])

# The report's own words, which would take a second to import; a test compares them.
METRICS = ("rms", "frame_rms", "max_deviation", "volume_change")

LIMIT_OPTION_NAMES = ("max_rms", "max_frame_rms", "max_deviation", "max_volume_change")
DEFAULT_REGRESSION = Decimal(10)


@dataclass(frozen=True, slots=True)
class LimitValue:
    """The most that a figure may be, in percent or in file units."""

    value: Decimal
    is_percent: bool


class LimitValueType(click.ParamType):  # type: ignore[type-arg]  # not subscriptable before click 8.4
    """A number, zero or above: percent with the sign %, file units without."""

    name = "number[%]"
    expected = "0.5% or, in file units, 0.02"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Parse the text."""
        if isinstance(value, LimitValue):
            return value
        number = r"(\d+\.?\d*|\.\d+)(e[+-]?\d{1,3})?"
        match = re.fullmatch(rf"\+?({number})\s*(%?)", str(value).strip(), re.ASCII | re.IGNORECASE)
        if not match or not math.isfinite(float(match[1])):
            self.fail(
                f"{value!r} is not a limit; expected a finite number, zero or above, such as "
                f"{self.expected}",
                param,
                ctx,
            )
        return self.make_value(Decimal(match[1]), bool(match[4]))

    def make_value(self, value: Decimal, has_sign: bool) -> Any:
        """What the option's value is."""
        return LimitValue(value, has_sign)


class PercentType(LimitValueType):
    """A number of percent, zero or above, with the sign or without."""

    expected = "2%"

    def make_value(self, value: Decimal, has_sign: bool) -> Any:
        """Percent in any case."""
        return LimitValue(value, True)


def limit_options(command: Command) -> Command:
    """--max-rms and the other limits, --baseline and --max-regression."""
    length = "percent of the diagonal, or file units without the sign."
    for option in (
        click.option(
            "--max-regression",
            type=PercentType(),
            help="By how much a figure may pass that of --baseline.  [default: 10%]",
        ),
        click.option(
            "--baseline",
            type=PATH_TYPE,
            help="Compare with this JSON of an earlier report or batch: rms, the worst frame's "
            "rms, max deviation and volume change, as printed.",
        ),
        click.option(
            "--max-volume-change",
            type=PercentType(),
            help="Most that a frame's volume may change, percent; closed models only.",
        ),
        click.option(
            "--max-deviation",
            type=LimitValueType(),
            help=f"Most for any vertex of any frame, {length}",
        ),
        click.option(
            "--max-frame-rms",
            type=LimitValueType(),
            help=f"Most for the rms of the worst frame, {length}",
        ),
        click.option(
            "--max-rms",
            type=LimitValueType(),
            help=f"Most for the rms over the clip, the headline, {length}  A figure over its "
            "limit is exit code 3.",
        ),
    ):
        command = option(command)
    return command


def pop_limits(options: dict[str, Any], load_baseline: Callable[..., Any] | None = None) -> Any:
    """Take the limits' options out of `options`, as `Limits`; a baseline is read.

    Parameters
    ----------
    options : dict
        By parameters' names.
    load_baseline : callable, optional
        In place of `read_baseline`, for who asks for one baseline many times.

    Raises
    ------
    click.UsageError
        When there is a regression and no baseline.
    InputError
        When the baseline is not one.
    """
    from cageik_cli.report.baseline import read_baseline
    from cageik_cli.report.limits import Limit, Limits

    values = {
        metric: options.pop(name) for metric, name in zip(METRICS, LIMIT_OPTION_NAMES, strict=True)
    }
    path: Path | None = options.pop("baseline")
    regression: LimitValue | None = options.pop("max_regression")
    if path is None and regression is not None:
        raise click.UsageError("--max-regression is of a --baseline; name one")
    limits = tuple(
        Limit(metric, most.value, "%" if most.is_percent else "units")
        for metric, most in values.items()
        if most is not None
    )
    if path is None:
        return Limits(limits)
    value = regression.value if regression else DEFAULT_REGRESSION
    return Limits(limits, (load_baseline or read_baseline)(path, value))


def echo_exceeded_limits(overview: Any) -> None:
    """Say on stderr which figures are over their limits, a line each."""
    from cageik_cli.report.views.text import format_check_row
    from cageik_cli.report.vocabulary import choose_vocabulary

    for entry in overview.clips:
        words = choose_vocabulary(entry.edited_from)
        for check in entry.gates:
            if check.passed is False:
                click.echo(f"{entry.name}: {': '.join(format_check_row(check, words))}", err=True)


def exit_with_code(overview: Any) -> None:
    """End with the exit code of a run, if that is not 0."""
    if overview.exit_code:
        raise click.exceptions.Exit(overview.exit_code)
