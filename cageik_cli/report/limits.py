"""Limits on the metrics of a result, typed or of an earlier run, and whether they are exceeded.

A metric is compared as it is printed, so that readers see the numbers that were compared. Those of
an earlier run are read from the JSON of a report, of several, or of a batch.
"""

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import ROUND_FLOOR, Decimal, localcontext
from pathlib import Path
from typing import Any

from cageik_cli.report.figures import (
    LENGTH_DIGITS,
    PERCENT_DECIMALS,
    REPORT_SCHEMA,
    ReportSummary,
    format_length,
    format_percent,
)
from cageik_cli.util.errors import FormatError, SettingError, error_context
from cageik_cli.util.json_files import JsonFormat, format_value, read_json
from cageik_cli.util.messages import Hint

METRICS = ("rms", "frame_rms", "max_deviation", "volume_change")
"""The rms of the clip and of its worst frame, the largest deviation and volume change."""

PERCENT, FILE_UNITS = "%", "units"

MAX_USUAL_PERCENT = 5
"""A limit in units that is more percent of the diagonal was probably meant in percent."""

MAX_PERCENT_ROUNDING = Decimal(5).scaleb(-PERCENT_DECIMALS - 1)
"""Percent; values up to this, half the last decimal, differ from run to run, and keep any limit."""

MAX_BASELINE_BYTES = 256 << 20
"""Largest file that is read."""

SUMMARY_FIELDS = {
    "rms": "rms_percent",
    "frame_rms": "worst_frame_rms_percent",
    "max_deviation": "max_deviation_percent",
    "volume_change": "volume_change_percent_max",
}
"""The metrics that are compared, and the summary's fields that hold them in percent."""

LENGTH_SPELLINGS = {
    "rms": ("max_rms", "max-rms", "rms"),
    "frame_rms": ("max_frame_rms", "max-frame-rms", "frame_rms", "worst_frame_rms"),
    "max_deviation": ("max_deviation", "max-deviation"),
}
"""How limits of lengths are written by hand: as the parameter first."""

_TYPE_NAMES: dict[type, str] = {dict: "an object", list: "a list", str: "a string"}


@dataclass(frozen=True, slots=True)
class Limit:
    """The largest value that a metric, one of `METRICS`, may have, as the user typed it.

    `unit` is `PERCENT`, of the diagonal or of the volume, or `FILE_UNITS` of the file.
    """

    metric: str
    value: Decimal
    unit: str = PERCENT


@dataclass(frozen=True, slots=True)
class Baseline:
    """Metrics of an earlier run, and by how much they may be exceeded.

    Attributes
    ----------
    path : Path
        The file that the metrics were read from.
    metrics : mapping of str to mapping of str to float or None
        In percent, by the result's name and the metric; a change without its sign, None where
        the metric was not defined.
    max_regression : Decimal
        Percent of the earlier value.
    is_matched_by_name : bool
        Whether results are compared only with earlier ones of the same name; otherwise a file that
        holds one result is compared with a result of any name.
    """

    path: Path
    metrics: Mapping[str, Mapping[str, float | None]]
    max_regression: Decimal
    is_matched_by_name: bool = False

    def find_counterpart(self, name: str) -> Mapping[str, float | None] | None:
        """Return the earlier metrics of a result; None if there are none."""
        if len(self.metrics) == 1 and not self.is_matched_by_name:
            return next(iter(self.metrics.values()))
        return self.metrics.get(name)


@dataclass(frozen=True, slots=True)
class Limits:
    """All limits of a result, typed ones and a baseline."""

    limits: tuple[Limit, ...] = ()
    baseline: Baseline | None = None

    def match_by_name(self) -> "Limits":
        """Return the same limits for several results, each compared with its own name only."""
        if self.baseline is None:
            return self
        return replace(self, baseline=replace(self.baseline, is_matched_by_name=True))


@dataclass(frozen=True, slots=True)
class LimitCheck:
    """A limit and the value that was compared with it.

    Attributes
    ----------
    found : float, optional
        The value as it is printed, a change without its sign; None when it is not defined.
    frame : str, optional
        The frame with the worst value.
    passed : bool, optional
        Whether the value is at or below the limit; None when it is not defined.
    baseline : float, optional
        The earlier value, as it is printed, that the limit was computed from; None if it was typed.
    """

    metric: str
    unit: str
    limit: float
    found: float | None
    frame: str | None
    passed: bool | None
    baseline: float | None = None

    @property
    def state(self) -> str:
        """The verdict on the limit, which decides its colour: "good", "bad" or "none"."""
        return {True: "good", False: "bad", None: "none"}[self.passed]

    @property
    def verdict(self) -> str:
        """The verdict on the limit in words."""
        return {True: "within limit", False: "over limit", None: "not checked"}[self.passed]

    def format_found(self) -> str:
        """Format the value as in all views."""
        if self.found is None:
            return "not defined"
        return format_percent(self.found) if self.unit == PERCENT else format_length(self.found)

    def format_limit(self) -> str:
        """Format the limit as it was typed, or as metrics are printed if it has a baseline."""
        return f"{self.limit:.10g}" if self.baseline is None else format_percent(self.limit)

    def format_limit_with_baseline(self, unit: str = "") -> str:
        """Format the limit and its baseline, if it has one; `unit` is put behind numbers."""
        limit = f"{self.format_limit()}{unit}"
        if self.baseline is None:
            return limit
        return f"{limit} (baseline {format_percent(self.baseline)}{unit})"


def check_limits(name: str, summary: ReportSummary, limits: Limits) -> tuple[LimitCheck, ...]:
    """Compare a result of this name and summary with the limits.

    A limit computed from a baseline is the earlier value as printed, times 1 + regression/100,
    rounded down to the decimals in which metrics are printed. Rounding changes no verdict, since
    the compared values have no more decimals, or are rounding themselves; and a metric that has not
    changed always passes.
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
    """Write a sentence on each metric that the baseline lacks."""
    baseline = limits.baseline
    if baseline is None:
        return ()
    baseline_metrics = baseline.find_counterpart(name)
    if baseline_metrics is None:
        return (f"not compared with the baseline: {baseline.path} has no result named {name}",)
    return tuple(
        f"{metric.replace('_', ' ')} not compared with the baseline: not defined in {baseline.path}"
        for metric, value in baseline_metrics.items()
        if value is None and _round_as_printed(summary, metric, PERCENT) is not None
    )


def list_limit_notes(limits: Limits, diagonal: float) -> tuple[str, ...]:
    """Write a sentence on each limit in units that is large beside the diagonal."""
    return tuple(
        f"the limit of {limit.value:.10g} units for the {limit.metric.replace('_', ' ')} is "
        f"{100 * float(limit.value) / diagonal:.4g} % of the diagonal, more than "
        f"{MAX_USUAL_PERCENT} %; if percent is meant, give {limit.value:.10g}%"
        for limit in limits.limits
        if limit.unit == FILE_UNITS and 100 * float(limit.value) > MAX_USUAL_PERCENT * diagonal
    )


def _allow_regression(baseline_value: Decimal, max_regression: Decimal) -> Decimal:
    """Return the limit for an earlier value, no larger than the largest float."""
    # Enough digits for the exact product of any two floats, before it is rounded.
    with localcontext(prec=1000):
        max_value = (baseline_value + baseline_value * max_regression / 100).quantize(
            Decimal(1).scaleb(-PERCENT_DECIMALS), ROUND_FLOOR
        )
    return min(max_value, Decimal(sys.float_info.max))


def _check_limit(limit: Limit, summary: ReportSummary) -> LimitCheck:
    found = _round_as_printed(summary, limit.metric, limit.unit)
    is_rounding = limit.unit == PERCENT and found is not None and found <= MAX_PERCENT_ROUNDING
    frames = {
        "max_deviation": summary.max_deviation_frame,
        "volume_change": summary.volume_change_frame,
    }
    return LimitCheck(
        metric=limit.metric,
        unit=limit.unit,
        limit=float(limit.value),
        found=None if found is None else float(found),
        frame=frames.get(limit.metric, summary.worst_frame),
        passed=None if found is None else found <= limit.value or is_rounding,
    )


def _round_as_printed(summary: ReportSummary, metric: str, unit: str) -> Decimal | None:
    """Return a metric as it is printed, a change without its sign; None if not defined."""
    change = summary.volume_change_percent_max
    value = {
        ("rms", PERCENT): summary.rms_percent,
        ("rms", FILE_UNITS): summary.rms,
        ("frame_rms", PERCENT): summary.worst_frame_rms_percent,
        ("frame_rms", FILE_UNITS): summary.worst_frame_rms,
        ("max_deviation", PERCENT): summary.max_deviation_percent,
        ("max_deviation", FILE_UNITS): summary.max_deviation,
        ("volume_change", PERCENT): None if change is None else abs(change),
    }[metric, unit]
    if value is None:
        return None
    return Decimal(format_percent(value) if unit == PERCENT else f"{value:.{LENGTH_DIGITS}g}")


def make_overall_verdict(checks: Sequence[LimitCheck]) -> tuple[str, str]:
    """Return the verdict on all limits of a result: as `LimitCheck.state`, and in words."""
    if not checks:
        return "none", "No limits set"
    over = sum(check.passed is False for check in checks)
    within = sum(check.passed is True for check in checks)
    rest = len(checks) - over - within
    unchecked = f"; {rest} could not be checked" if rest else ""
    if over:
        share = f"{over} of {len(checks)} limits" if len(checks) > 1 else "the limit"
        return "bad", f"Over {share}{unchecked}"
    if within:
        share = "the limit" if len(checks) == 1 else f"{within} of {len(checks)} limits"
        return "good", f"Within {share}{unchecked}"
    return "none", "No limit could be checked"


def read_baseline(path: Path, max_regression: Decimal) -> Baseline:
    """Read the metrics that results are compared with.

    Parameters
    ----------
    path : Path
        Output of `cageik report --json`, for one result or several, or the report.json of a batch;
        failed clips in it have no metrics.
    max_regression : Decimal
        By how many percent the metrics may be exceeded.
    """
    with error_context(path):
        metrics: dict[str, dict[str, float | None]] = {}
        document = read_json(path, JsonFormat("the JSON of an earlier report", MAX_BASELINE_BYTES))
        for name, found in _iterate_results(document):
            if name in metrics:
                raise FormatError(
                    f"holds two results named {name}, expected one; give the results different "
                    "names, or use the report of a batch"
                )
            metrics[name] = found
        if not metrics:
            raise FormatError(
                "holds no result with metrics, expected at least one; name the JSON of "
                "cageik report or cageik batch"
            )
    return Baseline(path, metrics, max_regression)


def _iterate_results(document: Any) -> Iterator[tuple[str, dict[str, float | None]]]:
    """Yield the name and the metrics of each result that has metrics."""
    if isinstance(document, list):
        for k, record in enumerate(document):
            with error_context(f"[{k}]"):
                yield _parse_record(_check_type(record, dict))
    elif "clips" in _check_type(document, dict):
        _check_schema(document)
        for k, entry in enumerate(_get_member(document, "clips", list)):
            with error_context(f"clips[{k}]"):
                if _check_type(entry, dict).get("summary") is not None:
                    yield _get_member(entry, "name", str), _parse_metrics(entry)
    else:
        _check_units(document)
        yield _parse_record(document)


def _check_units(held: dict[str, Any]) -> None:
    """Refuse lengths without a unit, written by hand where a report has percent."""
    for metric, spellings in LENGTH_SPELLINGS.items():
        bare = [key for key in spellings if _parse_finite(held.get(key)) is not None]
        if bare and SUMMARY_FIELDS[metric] not in held:
            value, option = format_value(held[bare[0]]), spellings[0]
            raise SettingError(
                f"{bare[0]!r} is {value}, which has no unit; write {SUMMARY_FIELDS[metric]}, "
                "in percent, or give "
                + Hint(option, f"{value}%")
                + " or "
                + Hint(option, f"{value}units")
            )


def _parse_record(record: dict[str, Any]) -> tuple[str, dict[str, float | None]]:
    _check_schema(record)
    return _get_member(record, "result", str), _parse_metrics(record)


def _check_schema(record: dict[str, Any]) -> None:
    schema = record.get("schema")
    if schema != REPORT_SCHEMA or isinstance(schema, bool):
        raise FormatError(
            f"schema is {format_value(schema)}, expected {REPORT_SCHEMA}; name the JSON of "
            "cageik report or cageik batch, written by this version"
        )


def _parse_metrics(record: dict[str, Any]) -> dict[str, float | None]:
    summary = _get_member(record, "summary", dict)
    with error_context("summary"):
        _check_units(summary)
    metrics: dict[str, float | None] = {}
    for metric, name in SUMMARY_FIELDS.items():
        value, is_change = summary.get(name), metric == "volume_change"
        if is_change and value is None and name in summary:
            metrics[metric] = None
            continue
        size = _parse_finite(value)
        if size is None or (size < 0 and not is_change):
            expected = " or null" if is_change else ", zero or above"
            raise FormatError(
                f"summary.{name} is {format_value(value)}, expected a finite number{expected}"
            )
        metrics[metric] = abs(size)
    return metrics


def _parse_finite(value: Any) -> float | None:
    """Return a JSON number as a float; None if it is no number, or too large for a float."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def _get_member(record: dict[str, Any], name: str, kind: type) -> Any:
    with error_context(name):
        return _check_type(record.get(name), kind)


def _check_type(value: Any, kind: type) -> Any:
    if not isinstance(value, kind):
        raise FormatError(
            f"is {format_value(value)}, expected {_TYPE_NAMES[kind]}; name the JSON of cageik "
            "report or cageik batch"
        )
    return value
