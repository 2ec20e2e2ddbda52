"""Limits on the metrics of a result, typed or of an earlier run, and whether they are exceeded.

A metric is compared as it is printed, so that readers see the numbers that were compared. Those of
an earlier run are read from the JSON of a report, of several, or of a batch.
"""

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import ROUND_FLOOR, Decimal, localcontext
from itertools import takewhile
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
from cageik_cli.util.text import to_unicode

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
    digests : mapping of str to str
        The digest of each result's frames, by its name; edits and reports of earlier versions have
        none.
    taken : frozenset of str
        The names of all results of a run of several; each is compared with its own name.
    allow_new, allow_missing : bool
        Whether a run may have results that the file lacks, and lack some that it has.
    """

    path: Path
    metrics: Mapping[str, Mapping[str, float | None]]
    max_regression: Decimal
    digests: Mapping[str, str] = field(default_factory=dict)
    taken: frozenset[str] = frozenset()
    allow_new: bool = False
    allow_missing: bool = False

    def find_counterpart(self, name: str, digest: str | None) -> str | None:
        """Return the earlier name of a result: its own, else that of the same frames, or None.

        Of several with the same frames, it is the one whose name ends most alike.

        Raises
        ------
        FormatError
            When the only result of the file is of another clip than the only one of the run.
        """
        if name in self.metrics:
            return name
        same = [
            earlier
            for earlier, known in self.digests.items()
            if known == digest and earlier not in self.taken
        ]
        if same:
            return max(
                same,
                key=lambda earlier: _count_alike(earlier[::-1], name.removesuffix(".h5")[::-1]),
            )
        if len(self.metrics) == 1 and not self.taken:
            raise FormatError(
                f"{self.path}: holds {next(iter(self.metrics))} only, neither the name nor the "
                f"frames of {name}; name the baseline of this clip"
            )
        return None


def _count_alike(first: str, second: str) -> int:
    pairs = zip(first, second, strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))


@dataclass(frozen=True, slots=True)
class Gap:
    """A result that is in the run or in the baseline, but not in both; it fails the gate.

    Attributes
    ----------
    name : str
        Of the result.
    baseline : str
        The name of the file of the baseline.
    is_new : bool
        Whether the baseline lacks it; else the run does.
    """

    name: str
    baseline: str
    is_new: bool

    @property
    def text(self) -> str:
        """What is wrong."""
        if self.is_new:
            return f"not in the baseline {self.baseline}"
        return f"in the baseline {self.baseline}, not in this run"


@dataclass(frozen=True, slots=True)
class Limits:
    """All limits of a result, typed ones and a baseline."""

    limits: tuple[Limit, ...] = ()
    baseline: Baseline | None = None

    def match_several(self, names: Iterable[str]) -> "Limits":
        """Return the same limits for each of several results of these names."""
        if self.baseline is None:
            return self
        return replace(self, baseline=replace(self.baseline, taken=frozenset(names)))

    def find_counterpart(self, name: str, digest: str | None) -> str | None:
        """Return the name that the baseline has for a result; None without one."""
        return None if self.baseline is None else self.baseline.find_counterpart(name, digest)


@dataclass(frozen=True, slots=True)
class LimitCheck:
    """A limit and the value that was compared with it.

    Attributes
    ----------
    metric : str
        One of `METRICS`: rms, frame_rms, max_deviation or volume_change.
    unit : str
        Of the limit and the values: %, of the diagonal or of the volume, or units, of the file.
    limit : float
        The largest value that is allowed.
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


def check_limits(
    counterpart: str | None, summary: ReportSummary, limits: Limits
) -> tuple[LimitCheck, ...]:
    """Compare the summary of a result with the limits; `counterpart` is its name in the baseline.

    A limit computed from a baseline is the earlier value as printed, times 1 + regression/100,
    rounded down to the decimals in which metrics are printed. Rounding changes no verdict, since
    the compared values have no more decimals, or are rounding themselves; and a metric that has not
    changed always passes.
    """
    checks = [_check_limit(limit, summary) for limit in limits.limits]
    baseline = limits.baseline
    if baseline is not None and counterpart is not None:
        for metric, value in baseline.metrics[counterpart].items():
            if value is not None:
                baseline_value = Decimal(format_percent(value))
                limit = Limit(metric, _allow_regression(baseline_value, baseline.max_regression))
                checks.append(replace(_check_limit(limit, summary), baseline=float(baseline_value)))
    return tuple(checks)


def list_baseline_notes(
    name: str,
    digest: str | None,
    summary: ReportSummary,
    limits: Limits,
) -> tuple[str, ...]:
    """Write a sentence on how a result was matched, and on each metric that the baseline lacks."""
    baseline = limits.baseline
    if baseline is None:
        return ()
    notes = []
    counterpart = baseline.find_counterpart(name, digest)
    if not baseline.digests:
        notes.append(f"{baseline.path.name} has no digests of frames: compared by name alone")
    if counterpart is None:
        return (*notes, f"not compared with the baseline: {baseline.path.name} has no such clip")
    if counterpart != name:
        notes.append(f"renamed: its frames are those of {counterpart} in {baseline.path.name}")
    elif digest is not None and baseline.digests.get(name, digest) != digest:
        notes.append(f"its frames differ from those in {baseline.path.name}")
    notes += (
        f"{metric.replace('_', ' ')} not compared with the baseline: not defined in "
        f"{baseline.path.name}"
        for metric, value in baseline.metrics[counterpart].items()
        if value is None and _round_as_printed(summary, metric, PERCENT) is not None
    )
    return tuple(notes)


def find_frames_digest(sources: Mapping[str, Any], edited_from: str | None) -> str | None:
    """Return the digest of the frames that a result was made of; None of an edit.

    Clips of one file share the digest of the file, and differ in the name behind its own.
    """
    frames = sources.get("frames")
    if edited_from is not None or not isinstance(frames, dict):
        return None
    digest, name = frames.get("sha256"), frames.get("name")
    if not isinstance(digest, str) or not isinstance(name, str):
        return None
    return digest + "".join(name.partition("::")[1:])


def find_gaps(
    names: Iterable[str], limits: Mapping[str, Limits], counterparts: Mapping[str, str | None]
) -> tuple[Gap, ...]:
    """Find results that the run or a baseline lacks, and that are not allowed.

    Parameters
    ----------
    names : iterable of str
        All results of the run, failed ones, too.
    limits : mapping of str to Limits
        By name.
    counterparts : mapping of str to str or None
        What the baseline has for each result that did not fail.
    """
    held = {*names, *counterparts.values()}
    gaps: dict[Gap, None] = {}
    claimed: set[tuple[Path, str]] = set()
    searched: set[Path] = set()
    for name, one in limits.items():
        baseline = one.baseline
        if baseline is None:
            continue
        path, file = baseline.path, baseline.path.name
        if name in counterparts:
            earlier = counterparts[name]
            # Of copies of a clip that was renamed, one is that clip.
            is_new = earlier is None or (path, earlier) in claimed
            if earlier is not None:
                claimed.add((path, earlier))
            if is_new and not baseline.allow_new:
                gaps[Gap(name, file, is_new=True)] = None
        if not baseline.allow_missing and path not in searched:
            searched.add(path)
            gaps |= {Gap(n, file, is_new=False): None for n in baseline.metrics if n not in held}
    return tuple(gaps)


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
        digests: dict[str, str] = {}
        document = read_json(path, JsonFormat("the JSON of an earlier report", MAX_BASELINE_BYTES))
        for given, found, digest in _iterate_results(document):
            name = to_unicode(given)
            if name in metrics:
                raise FormatError(
                    f"holds two results named {name}, expected one; give the results different "
                    "names, or use the report of a batch"
                )
            metrics[name] = found
            if digest is not None:
                digests[name] = digest
        if not metrics:
            raise FormatError(
                "holds no result with metrics, expected at least one; name the JSON of "
                "cageik report or cageik batch"
            )
    return Baseline(path, metrics, max_regression, digests)


def _iterate_results(document: Any) -> Iterator[tuple[str, dict[str, float | None], str | None]]:
    """Yield the name, the metrics and the frames' digest of each result that has metrics."""
    if isinstance(document, list):
        for k, record in enumerate(document):
            with error_context(f"[{k}]"):
                yield _parse_record(_check_type(record, dict))
    elif "clips" in _check_type(document, dict):
        _check_schema(document)
        for k, entry in enumerate(_get_member(document, "clips", list)):
            with error_context(f"clips[{k}]"):
                if _check_type(entry, dict).get("summary") is not None:
                    yield (
                        _get_member(entry, "name", str),
                        _parse_metrics(entry),
                        _parse_digest(entry),
                    )
    else:
        _check_units(document)
        yield _parse_record(document)


def _check_units(held: dict[str, Any]) -> None:
    """Refuse lengths without a unit, written by hand where a report has percent."""
    for metric, spellings in LENGTH_SPELLINGS.items():
        bare = [key for key in spellings if _parse_number(held.get(key)) is not None]
        if bare and SUMMARY_FIELDS[metric] not in held:
            value, option = format_value(held[bare[0]]), spellings[0]
            raise SettingError(
                f"{bare[0]!r} is {value}, which has no unit; write {SUMMARY_FIELDS[metric]}, "
                "in percent, or give "
                + Hint(option, f"{value}%")
                + " or "
                + Hint(option, f"{value}units")
            )


def _parse_record(record: dict[str, Any]) -> tuple[str, dict[str, float | None], str | None]:
    _check_schema(record)
    return _get_member(record, "result", str), _parse_metrics(record), _parse_digest(record)


def _parse_digest(record: dict[str, Any]) -> str | None:
    """Return the digest of the frames; None in a record of an earlier version."""
    if record.get("sources") is None:
        return None
    return find_frames_digest(_get_member(record, "sources", dict), record.get("edited_from"))


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
        size = _parse_number(value)
        if size is None or (size < 0 and not is_change):
            expected = " or null" if is_change else ", zero or above"
            raise FormatError(
                f"summary.{name} is {format_value(value)}, expected a finite number{expected}"
            )
        metrics[metric] = abs(size)
    return metrics


def _parse_number(value: Any) -> float | None:
    """Return a number of `parse_json`, which are finite, as a float; None if it is none."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if is_number else None


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
