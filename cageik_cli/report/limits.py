"""Limits that a result is to keep, and whether it does.

A figure is compared as it is printed, so that what one reads is what was judged.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import ROUND_FLOOR, Decimal, localcontext
from pathlib import Path

from cageik_cli.report.figures import ReportSummary, format_length, format_percent

METRICS = ("rms", "frame_rms", "max_deviation", "volume_change")
"""The clip's rms, that of its worst frame, the largest deviation, the largest volume change."""

PERCENT, UNITS = "%", "units"

DECIMAL_DIGITS = 1000
"""Enough for the product of any two floats to be exact before it is rounded."""


@dataclass(frozen=True, slots=True)
class Limit:
    """The most that a figure may be.

    Attributes
    ----------
    metric : str
        One of `METRICS`.
    value : Decimal
        As it was typed.
    unit : str
        `PERCENT`, of the diagonal or of the volume, or `UNITS` of the file.
    """

    metric: str
    value: Decimal
    unit: str = PERCENT


@dataclass(frozen=True, slots=True)
class Baseline:
    """Figures of an earlier run, and by how much they may be passed.

    Attributes
    ----------
    path : Path
        The file that they came from.
    figures : mapping of str to mapping of str to float or None
        In percent, by the result's name and the metric; a change without its sign, None where
        the figure was not defined.
    max_regression : Decimal
        Percent of a figure.
    is_matched_by_name : bool
        Whether a result is compared with that of its name alone; else the only one of the file is
        compared with whatever result there is.
    """

    path: Path
    figures: Mapping[str, Mapping[str, float | None]]
    max_regression: Decimal
    is_matched_by_name: bool = False

    def find_counterpart(self, name: str) -> Mapping[str, float | None] | None:
        """The earlier figures of a result; None if there are none."""
        if len(self.figures) == 1 and not self.is_matched_by_name:
            return next(iter(self.figures.values()))
        return self.figures.get(name)


@dataclass(frozen=True, slots=True)
class Limits:
    """All that a result is to keep."""

    limits: tuple[Limit, ...] = ()
    baseline: Baseline | None = None

    def match_by_name(self) -> "Limits":
        """The same for each of several results: a baseline then holds for those of its names."""
        if self.baseline is None:
            return self
        return replace(self, baseline=replace(self.baseline, is_matched_by_name=True))


@dataclass(frozen=True, slots=True)
class LimitCheck:
    """A limit, and what was found.

    Attributes
    ----------
    metric, unit : str
        As in `Limit`.
    limit : float
    found : float, optional
        As it is printed, a change without its sign; None when the figure is not defined.
    frame : str, optional
        Where the figure is worst.
    passed : bool, optional
        Whether what was found is no more than the limit; None when there is nothing to judge.
    baseline : float, optional
        The earlier figure, as it is printed, that the limit was made of; None if it was typed.
    """

    metric: str
    unit: str
    limit: float
    found: float | None
    frame: str | None
    passed: bool | None
    baseline: float | None = None


def check_limits(name: str, summary: ReportSummary, limits: Limits) -> tuple[LimitCheck, ...]:
    """What a result of this name and summary makes of the limits.

    A limit made of an earlier figure is that figure as printed, times 1 + regression/100, rounded
    down to the digits in which figures are printed. Rounding changes no verdict, since what is
    compared has no more digits; and a figure that has not changed always passes.
    """
    checks = [_check_limit(limit, summary) for limit in limits.limits]
    baseline = limits.baseline
    if baseline is not None:
        baseline_metrics = baseline.find_counterpart(name) or {}
        for metric, value in baseline_metrics.items():
            if value is not None:
                baseline_value = Decimal(format_percent(value))
                limit = Limit(metric, _allow_regression(baseline_value, baseline.max_regression))
                checks.append(replace(_check_limit(limit, summary), baseline=float(baseline_value)))
    return tuple(checks)


def missing_in_baseline(name: str, summary: ReportSummary, limits: Limits) -> tuple[str, ...]:
    """Sentences on what a baseline has no figure for."""
    baseline = limits.baseline
    if baseline is None:
        return ()
    baseline_metrics = baseline.find_counterpart(name)
    if baseline_metrics is None:
        return (f"not compared with {baseline.path}, which has no result of this name",)
    missing = [
        metric.replace("_", " ")
        for metric, value in baseline_metrics.items()
        if value is None and _round_as_printed(summary, metric, PERCENT) is not None
    ]
    return tuple(f"{metric} not compared: not defined in {baseline.path}" for metric in missing)


def _allow_regression(baseline_value: Decimal, max_regression: Decimal) -> Decimal:
    """The most that may become of a printed figure; a float, as records hold it."""
    with localcontext(prec=DECIMAL_DIGITS):
        max_value = (baseline_value + baseline_value * max_regression / 100).quantize(
            Decimal(format_percent(0)), ROUND_FLOOR
        )
    return min(max_value, Decimal(sys.float_info.max))


def _check_limit(limit: Limit, summary: ReportSummary) -> LimitCheck:
    found, frame = (
        _round_as_printed(summary, limit.metric, limit.unit),
        _worst_frame_name(summary, limit.metric),
    )
    return LimitCheck(
        metric=limit.metric,
        unit=limit.unit,
        limit=float(limit.value),
        found=None if found is None else float(found),
        frame=frame,
        passed=None if found is None else found <= limit.value,
    )


def _round_as_printed(summary: ReportSummary, metric: str, unit: str) -> Decimal | None:
    """The figure as it is printed."""
    change = summary.volume_change_percent_max
    value = {
        ("rms", PERCENT): summary.rms_percent,
        ("rms", UNITS): summary.rms,
        ("frame_rms", PERCENT): summary.worst_frame_rms_percent,
        ("frame_rms", UNITS): summary.worst_frame_rms,
        ("max_deviation", PERCENT): summary.max_deviation_percent,
        ("max_deviation", UNITS): summary.max_deviation,
        ("volume_change", PERCENT): None if change is None else abs(change),
    }[metric, unit]
    if value is None:
        return None
    return Decimal(format_percent(value) if unit == PERCENT else format_length(value))


def _worst_frame_name(summary: ReportSummary, metric: str) -> str | None:
    return {
        "max_deviation": summary.max_deviation_frame,
        "volume_change": summary.volume_change_frame,
    }.get(metric, summary.worst_frame)


@dataclass(frozen=True, slots=True)
class Verdict:
    """What is said of limits.

    Attributes
    ----------
    state : str
        "good", "bad" or "none": how it is coloured.
    text : str
    """

    state: str
    text: str


def make_verdict(check: LimitCheck) -> Verdict:
    """What is said of one limit."""
    return {
        True: Verdict("good", "within limit"),
        False: Verdict("bad", "over limit"),
        None: Verdict("none", "not judged"),
    }[check.passed]


def make_overall_verdict(checks: Sequence[LimitCheck]) -> Verdict:
    """What is said of all limits of a result."""
    if not checks:
        return Verdict("none", "No limits were stated")
    over = sum(check.passed is False for check in checks)
    kept = sum(gate.passed is True for gate in checks)
    rest = len(checks) - over - kept
    unjudged = f"; {rest} could not be judged" if rest else ""
    if over:
        share = f"{over} of {len(checks)} limits" if len(checks) > 1 else "the limit"
        return Verdict("bad", f"Over {share}{unjudged}")
    if kept:
        share = "the limit" if len(checks) == 1 else f"{kept} of {len(checks)} limits"
        return Verdict("good", f"Within {share}{unjudged}")
    return Verdict("none", "No limit could be judged")


def format_limit(check: LimitCheck) -> str:
    """The limit as it was typed, or as figures are printed when it was made of one."""
    return f"{check.limit:.10g}" if check.baseline is None else format_percent(check.limit)


def format_limit_with_baseline(check: LimitCheck, unit: str = "") -> str:
    """The limit, and what it was made of if it was not typed; `unit` is put behind numbers."""
    limit = f"{format_limit(check)}{unit}"
    if check.baseline is None:
        return limit
    return f"{limit} (baseline {format_percent(check.baseline)}{unit})"


def format_measured(check: LimitCheck) -> str:
    """What was found, as it is printed everywhere."""
    if check.found is None:
        return "not defined"
    return format_percent(check.found) if check.unit == PERCENT else format_length(check.found)
