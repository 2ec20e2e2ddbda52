"""Options of every command that judges results: what they are to keep."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any, TypeVar

import click

from cageik_cli.cli.options.common import PATH

Command = TypeVar("Command", bound=Callable[..., Any])

# The report's own words, which would take a second to import; a test compares them.
METRICS = ("rms", "frame_rms", "max_deviation", "volume_change")

OPTIONS = ("max_rms", "max_frame_rms", "max_deviation", "max_volume_change")
REGRESSION = Decimal(10)


@dataclass(frozen=True, slots=True)
class Most:
    """The most that a figure may be, in percent or in file units."""

    value: Decimal
    is_percent: bool


class MostType(click.ParamType):  # type: ignore[type-arg]  # not subscriptable before click 8.4
    """A number, zero or above: percent with the sign %, file units without."""

    name = "number[%]"
    expected = "0.5% or, in file units, 0.02"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Parse the text."""
        if isinstance(value, Most):
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
        return self.made(Decimal(match[1]), bool(match[4]))

    def made(self, value: Decimal, has_sign: bool) -> Any:
        """What the option's value is."""
        return Most(value, has_sign)


class PercentType(MostType):
    """A number of percent, zero or above, with the sign or without."""

    expected = "2%"

    def made(self, value: Decimal, has_sign: bool) -> Any:
        """Percent in any case."""
        return Most(value, True)


def gate_options(command: Command) -> Command:
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
            type=PATH,
            help="Compare with this JSON of an earlier report or batch: rms, the worst frame's "
            "rms, max deviation and volume change, as printed.",
        ),
        click.option(
            "--max-volume-change",
            type=PercentType(),
            help="Most that a frame's volume may change, percent; closed models only.",
        ),
        click.option(
            "--max-deviation", type=MostType(), help=f"Most for any vertex of any frame, {length}"
        ),
        click.option(
            "--max-frame-rms",
            type=MostType(),
            help=f"Most for the rms of the worst frame, {length}",
        ),
        click.option(
            "--max-rms",
            type=MostType(),
            help=f"Most for the rms over the clip, the headline, {length}  A figure over its "
            "limit is exit code 3.",
        ),
    ):
        command = option(command)
    return command


def limits_of(options: dict[str, Any], read: Callable[..., Any] | None = None) -> Any:
    """Take the limits' options out of `options`, as `Limits`; a baseline is read.

    Parameters
    ----------
    options : dict
        By parameters' names.
    read : callable, optional
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

    mosts = {metric: options.pop(name) for metric, name in zip(METRICS, OPTIONS, strict=True)}
    path: Path | None = options.pop("baseline")
    regression: Most | None = options.pop("max_regression")
    if path is None and regression is not None:
        raise click.UsageError("--max-regression is of a --baseline; name one")
    limits = tuple(
        Limit(metric, most.value, "%" if most.is_percent else "units")
        for metric, most in mosts.items()
        if most is not None
    )
    if path is None:
        return Limits(limits)
    most = regression.value if regression else REGRESSION
    return Limits(limits, (read or read_baseline)(path, most))


def echo_over_limits(overview: Any) -> None:
    """Say on stderr which figures are over their limits, a line each."""
    from cageik_cli.report.views.text import gate_row
    from cageik_cli.report.vocabulary import wording_of

    for entry in overview.clips:
        words = wording_of(entry.edited_from)
        for gate in entry.gates:
            if gate.passed is False:
                click.echo(f"{entry.name}: {': '.join(gate_row(gate, words))}", err=True)


def exit_by(overview: Any) -> None:
    """End with the exit code of a run, if that is not 0."""
    if overview.exit_code:
        raise click.exceptions.Exit(overview.exit_code)
