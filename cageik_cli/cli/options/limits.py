"""Options of every command that checks limits on its results."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cageik_cli.cli.options.common import PATH_TYPE
from cageik_cli.cli.options.group import OptionGroup
from cageik_cli.util.errors import SettingError

if TYPE_CHECKING:
    from cageik_cli.report.limits import Baseline, Limits
    from cageik_cli.report.overview import Overview

    LoadBaseline = Callable[[Path, Decimal], Baseline]

DEFAULT_REGRESSION = Decimal(10)
"""Percent by which a figure may be above that of the baseline."""


@dataclass(frozen=True, slots=True)
class LimitValue:
    """A limit of a figure, in percent or in file units."""

    value: Decimal
    is_percent: bool


@dataclass(frozen=True, slots=True)
class LimitOptions:
    """The limits as they were typed; the baseline is not read yet.

    Raises
    ------
    click.UsageError
        When there is a regression and no baseline.
    """

    max_rms: LimitValue | None
    max_frame_rms: LimitValue | None
    max_deviation: LimitValue | None
    max_volume_change: LimitValue | None
    baseline: Path | None
    max_regression: LimitValue | None

    def __post_init__(self) -> None:
        if self.baseline is None and self.max_regression is not None:
            raise click.UsageError("--max-regression needs a --baseline; give both, or neither")

    def load(self, load_baseline: "LoadBaseline | None" = None) -> "Limits":
        """Return the limits, with those of the baseline.

        Parameters
        ----------
        load_baseline : callable, optional
            In place of `read_baseline`, for callers that ask for one baseline many times.

        Raises
        ------
        click.UsageError
            When the baseline states limits without units.
        InputError
            When the baseline cannot be read, or is not one.
        """
        from cageik_cli.report.baseline import read_baseline
        from cageik_cli.report.limits import METRICS, PERCENT, UNITS, Limit, Limits

        values = (self.max_rms, self.max_frame_rms, self.max_deviation, self.max_volume_change)
        limits = tuple(
            Limit(metric, most.value, PERCENT if most.is_percent else UNITS)
            for metric, most in zip(METRICS, values, strict=True)
            if most is not None
        )
        if self.baseline is None:
            return Limits(limits)
        regression = self.max_regression.value if self.max_regression else DEFAULT_REGRESSION
        try:
            baseline = (load_baseline or read_baseline)(self.baseline, regression)
        except SettingError as error:
            raise click.UsageError(str(error)) from error
        return Limits(limits, baseline)


_NUMBER = r"\+?((?:\d+\.?\d*|\.\d+)(?:e[+-]?\d{1,3})?)"


class PercentType(click.ParamType):  # type: ignore[type-arg]  # not subscriptable before click 8.4
    """A number of percent, zero or above, with or without the sign."""

    name = "number[%]"
    noun = "a limit"
    units: tuple[str, ...] = ("%", "")
    expected = "2%"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Parse the text."""
        if isinstance(value, LimitValue):
            return value
        match = re.fullmatch(rf"{_NUMBER}\s*(%|units|)", str(value).strip().lower(), re.ASCII)
        if not match or not math.isfinite(float(match[1])) or match[2] not in ("", *self.units):
            self.fail(
                f"{value!r} is not {self.noun}; expected a finite number, zero or above, such as "
                f"{self.expected}",
                param,
                ctx,
            )
        number, unit = match.groups()
        if unit not in self.units:
            self.fail(
                f"{value!r} has no unit; give {number}% (of the diagonal) or {number}units (of "
                "the file)",
                param,
                ctx,
            )
        return LimitValue(Decimal(number), unit != "units")


class LengthLimitType(PercentType):
    """A length, zero or above: percent of the diagonal, or file units; one of them is typed."""

    name = "length"
    units = ("%", "units")
    expected = "0.4% or, in file units, 0.01units"


LIMIT_OPTIONS = OptionGroup(
    "limits",
    LimitOptions,
    click.option(
        "--max-rms",
        type=LengthLimitType(),
        help="Fail with exit code 3 if the RMS error of the clip is above this: 0.4% of the "
        "diagonal, or 0.01units of the file.",
    ),
    click.option(
        "--max-frame-rms",
        type=LengthLimitType(),
        help="Fail if the RMS error of any frame is above this, in % or units.",
    ),
    click.option(
        "--max-deviation",
        type=LengthLimitType(),
        help="Fail if any vertex of any frame deviates by more than this, in % or units.",
    ),
    click.option(
        "--max-volume-change",
        type=PercentType(),
        help="Fail if the volume of any frame changes by more percent; closed models only.",
    ),
    click.option(
        "--baseline",
        type=PATH_TYPE,
        help="Fail if a figure is worse than in this JSON of an earlier report or batch.",
    ),
    click.option(
        "--max-regression",
        type=PercentType(),
        help="How much worse than --baseline a figure may be.  [default: 10%]",
    ),
)


def echo_exceeded_limits(overview: "Overview") -> None:
    """Print on stderr which figures are above their limits, one line each."""
    from cageik_cli.report.views.text import format_check_row

    for entry in overview.clips:
        for check in entry.gates:
            if check.passed is False:
                row = ": ".join(format_check_row(check, entry.vocabulary))
                click.echo(f"{entry.name}: {row}", err=True)


def exit_with_code(overview: "Overview") -> None:
    """End with the exit code of a run, if that is not 0."""
    if overview.exit_code:
        raise click.exceptions.Exit(overview.exit_code)
