"""Options of every command that checks limits on its results."""

from collections.abc import Callable
from dataclasses import MISSING, dataclass, replace
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cageik_cli.cli.group import spell_error
from cageik_cli.cli.options.group import OptionGroup, list_options
from cageik_cli.cli.options.types import LimitValue
from cageik_cli.util.errors import SettingError
from cageik_cli.util.settings import HelpGroup, declare_setting

if TYPE_CHECKING:
    from cageik_cli.report.limits import Baseline, Limits

    LoadBaseline = Callable[[Path, Decimal], Baseline]


@dataclass(frozen=True, slots=True)
class LimitOptions:
    """The limits as they were typed; the baseline is not read yet."""

    max_rms: LimitValue | None = declare_setting(
        MISSING,
        "Fail with exit code 3 if the RMS error of the clip is above this: 0.4% of the "
        "diagonal, or 0.01units of the file.",
        kind="length limit",
        group=HelpGroup.LIMITS,
    )
    max_frame_rms: LimitValue | None = declare_setting(
        MISSING,
        "Fail if the RMS error of any frame is above this, in % or units.",
        kind="length limit",
        group=HelpGroup.LIMITS,
    )
    max_deviation: LimitValue | None = declare_setting(
        MISSING,
        "Fail if any vertex of any frame deviates by more than this, in % or units.",
        kind="length limit",
        group=HelpGroup.LIMITS,
    )
    max_volume_change: LimitValue | None = declare_setting(
        MISSING,
        "Fail if the volume of any frame changes by more percent; closed models only.",
        kind="limit",
        group=HelpGroup.LIMITS,
    )
    baseline: Path | None = declare_setting(
        MISSING,
        "Fail if a figure is worse than in this JSON of an earlier report or batch.",
        role="read",
        group=HelpGroup.LIMITS,
    )
    max_regression: LimitValue | None = declare_setting(
        MISSING,
        "How much worse than --baseline a figure may be.",
        kind="limit",
        unset="10%",
        needs="baseline",
        group=HelpGroup.LIMITS,
    )
    allow_new: bool = declare_setting(
        False,
        "Accept clips that --baseline does not have.",
        needs="baseline",
        group=HelpGroup.LIMITS,
    )
    allow_missing: bool = declare_setting(
        False,
        "Accept that clips of --baseline are not in the run.",
        needs="baseline",
        group=HelpGroup.LIMITS,
    )

    def load(self, load_baseline: "LoadBaseline | None" = None) -> "Limits":
        """Return the limits, with those of the baseline.

        Parameters
        ----------
        load_baseline : callable, optional
            In place of `read_baseline`, for callers that ask for one baseline many times.
        """
        from cageik_cli.report.limits import (
            FILE_UNITS,
            METRICS,
            PERCENT,
            Limit,
            Limits,
            read_baseline,
        )

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
            raise click.UsageError(spell_error(error)) from error
        allowed = replace(baseline, allow_new=self.allow_new, allow_missing=self.allow_missing)
        return Limits(limits, allowed)


LIMIT_OPTIONS = OptionGroup("limits", LimitOptions, *list_options(LimitOptions))
