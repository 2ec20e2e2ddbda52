"""Metrics of an earlier run, read from the JSON of a report, of several, or of a batch."""

import math
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any

from cageik_cli.report.limits import Baseline
from cageik_cli.report.record import REPORT_SCHEMA
from cageik_cli.util.errors import FormatError, SettingError, error_context
from cageik_cli.util.json_files import JsonFormat, format_value, read_json
from cageik_cli.util.messages import Hint

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
