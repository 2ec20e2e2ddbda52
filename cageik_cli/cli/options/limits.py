"""Options of every command that checks limits on its results."""

from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cageik_cli.cli.command import option
from cageik_cli.cli.options.group import PATH_TYPE, OptionGroup
from cageik_cli.cli.options.types import LimitType, LimitValue
from cageik_cli.util.errors import SettingError
from cageik_cli.util.settings import HelpGroup

if TYPE_CHECKING:
    from cageik_cli.report.limits import Baseline, Limits

    LoadBaseline = Callable[[Path, Decimal], Baseline]


@dataclass(frozen=True, slots=True)
class LimitOptions:
    """The limits as they were typed; the baseline is not read yet."""

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
        """
        from cageik_cli.report.baseline import read_baseline
        from cageik_cli.report.limits import FILE_UNITS, METRICS, PERCENT, Limit, Limits

        values = (self.max_rms, self.max_frame_rms, self.max_deviation, self.max_volume_change)
        limits = tuple(
            Limit(metric, most.value, PERCENT if most.is_percent else FILE_UNITS)
            for metric, most in zip(METRICS, values, strict=True)
            if most is not None
        )
        if self.baseline is None:
            return Limits(limits)
        regression = self.max_regression.value if self.max_regression else Decimal(10)
        try:
            baseline = (load_baseline or read_baseline)(self.baseline, regression)
        except SettingError as error:
            raise click.UsageError(str(error)) from error
        return Limits(limits, baseline)


LIMIT_OPTIONS = OptionGroup(
    "limits",
    LimitOptions,
    option(
        "--max-rms",
        type=LimitType(is_length=True),
        help="Fail with exit code 3 if the RMS error of the clip is above this: 0.4% of the "
        "diagonal, or 0.01units of the file.",
    ),
    option(
        "--max-frame-rms",
        type=LimitType(is_length=True),
        help="Fail if the RMS error of any frame is above this, in % or units.",
    ),
    option(
        "--max-deviation",
        type=LimitType(is_length=True),
        help="Fail if any vertex of any frame deviates by more than this, in % or units.",
    ),
    option(
        "--max-volume-change",
        type=LimitType(is_length=False),
        help="Fail if the volume of any frame changes by more percent; closed models only.",
    ),
    option(
        "--baseline",
        type=PATH_TYPE,
        help="Fail if a figure is worse than in this JSON of an earlier report or batch.",
    ),
    option(
        "--max-regression",
        type=LimitType(is_length=False),
        help="How much worse than --baseline a figure may be.  [default: 10%]",
    ),
    group=HelpGroup.LIMITS,
)
