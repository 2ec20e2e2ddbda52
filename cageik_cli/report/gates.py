"""Limits that a result is to keep, and whether it does.

A figure is compared as it is printed, so that what one reads is what was judged.
"""

from dataclasses import dataclass
from decimal import Decimal

from cageik_cli.report.figures import Summary, percent_text, units_text

METRICS = ("rms", "frame_rms", "max_deviation", "volume_change")
"""The clip's rms, that of its worst frame, the largest deviation, the largest volume change."""

PERCENT, UNITS = "%", "units"


@dataclass(frozen=True, slots=True)
class Limit:
    """The most that a figure may be.

    Attributes
    ----------
    metric : str
        One of `METRICS`.
    most : Decimal
        As it was typed.
    unit : str
        `PERCENT`, of the diagonal or of the volume, or `UNITS` of the file.
    """

    metric: str
    most: Decimal
    unit: str = PERCENT


@dataclass(frozen=True, slots=True)
class Limits:
    """All that a result is to keep."""

    limits: tuple[Limit, ...] = ()


@dataclass(frozen=True, slots=True)
class Gate:
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
    """

    metric: str
    unit: str
    limit: float
    found: float | None
    frame: str | None
    passed: bool | None


def judged(name: str, summary: Summary, limits: Limits) -> tuple[Gate, ...]:
    """What a result of this name and summary makes of the limits."""
    return tuple(_gate(limit, summary) for limit in limits.limits)


def _gate(limit: Limit, summary: Summary) -> Gate:
    found, frame = _printed(summary, limit.metric, limit.unit), _frame(summary, limit.metric)
    return Gate(
        metric=limit.metric,
        unit=limit.unit,
        limit=float(limit.most),
        found=None if found is None else float(found),
        frame=frame,
        passed=None if found is None else found <= limit.most,
    )


def _printed(summary: Summary, metric: str, unit: str) -> Decimal | None:
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
    return Decimal(percent_text(value) if unit == PERCENT else units_text(value))


def _frame(summary: Summary, metric: str) -> str | None:
    return {
        "max_deviation": summary.max_deviation_frame,
        "volume_change": summary.volume_change_frame,
    }.get(metric, summary.worst_frame)
