"""The two curves of the plot over the frames, and their limits: error, and volume or deviation."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cageik_cli.report.limits import PERCENT, LimitCheck
from cageik_cli.report.plots.style import CURVE_STYLES
from cageik_cli.report.record import Report
from cageik_cli.report.render.shading import MIN_SCALE_PERCENT
from cageik_cli.report.vocabulary import Vocabulary
from cageik_cli.util.arrays import Floats

MAX_LIMIT_REACH = 2.5
"""A limit has a line up to this many times the highest value of the curve."""


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """A curve over frames, and the limits on it.

    Attributes
    ----------
    metric : str
        What it shows: a key of `CURVE_STYLES`.
    numbers : (k,) float64
        Of the frames.
    values : (k,) float64
        Percent; nan in gaps.
    label, axis_label : str
        Its names in the legend, and at its axis, with the unit.
    limits : tuple of (str, tuple of float)
        The label of each limit, and the heights of its lines, percent: two of opposite sign if the
        limit applies on both sides of zero.
    undrawn_limits : tuple of str
        Labels of limits without a line: on a metric without a curve, or far above the curve.
    unfitted : Series, optional
        The same measure with the weights before a fit.
    """

    metric: str
    numbers: Floats
    values: Floats
    label: str
    axis_label: str = ""
    limits: tuple[tuple[str, tuple[float, ...]], ...] = ()
    undrawn_limits: tuple[str, ...] = ()
    unfitted: "Series | None" = None

    @property
    def style(self) -> dict[str, Any]:
        """Colour, line and marker, in matplotlib's terms."""
        return dict(CURVE_STYLES[self.metric])

    @property
    def is_signed(self) -> bool:
        """Whether limits apply on both sides of zero."""
        return self.metric == "volume_change"


def build_series(report: Report) -> tuple[Series, Series]:
    """Build the curves of the error and of the volume change.

    The largest deviation replaces the volume change if the model is open, or no frame has one.
    """
    frames, words = report.frames, report.vocabulary
    numbers = np.array([frame.number for frame in frames], np.float64)
    errors = _make_plottable(frame.rms_percent for frame in frames)
    limits, undrawn = _split_limits(report, ("rms", "frame_rms"), errors)
    error = Series(
        metric="rms",
        numbers=numbers,
        values=errors,
        label=f"RMS {words.measure}" + (", fitted" if report.unfitted else ""),
        axis_label=f"RMS {words.measure}, % of the diagonal",
        limits=limits,
        undrawn_limits=undrawn,
        unfitted=_build_unfitted(report, numbers),
    )
    metric, label, axis_label = "volume_change", "volume change", "volume change, %"
    values = _make_plottable(frame.volume_change for frame in frames)
    if not report.clip.closed or all(frame.volume_change is None for frame in frames):
        metric, label = "max_deviation", words.largest
        axis_label = f"{words.largest}, % of the diagonal"
        values = _make_plottable(frame.max_deviation_percent for frame in frames)
    limits, undrawn = _split_limits(report, (metric,), values)
    undrawn += tuple(
        label_limit(check, words)
        for check in report.gates
        if check.metric not in ("rms", "frame_rms", metric)
    )
    return error, Series(metric, numbers, values, label, axis_label, limits, undrawn)


def _make_plottable(metrics: Iterable[float | None]) -> Floats:
    """Return metrics with nan in gaps, clamped."""
    max_percent = 1e150  # matplotlib cannot draw axes of larger values
    values = np.array([np.nan if value is None else value for value in metrics])
    return np.asarray(np.clip(values, -max_percent, max_percent))


def _build_unfitted(report: Report, numbers: Floats) -> Series | None:
    """Build the curve of the weights before a fit."""
    before = report.unfitted
    if before is None:
        return None
    values = _make_plottable(before.rms_percent)
    return Series("unfitted", numbers[list(before.frames)], values, before.coordinates)


def _split_limits(
    report: Report, metrics: Sequence[str], values: Floats
) -> tuple[tuple[tuple[str, tuple[float, ...]], ...], tuple[str, ...]]:
    """Return the limits on a curve as in `Series`: those with lines, and those far above it.

    A limit has a line up to `MAX_LIMIT_REACH` times the highest value.
    """
    words = report.vocabulary
    reach = MAX_LIMIT_REACH * np.nanmax(np.abs(values), initial=MIN_SCALE_PERCENT)
    near, far = [], []
    for check in report.gates:
        if check.metric in metrics:
            to_percent = 1 if check.unit == PERCENT else 100 / report.clip.diagonal
            height, label = to_percent * check.limit, label_limit(check, words)
            if height <= reach:
                is_signed = check.metric == "volume_change"
                near.append((label, (height, -height) if is_signed else (height,)))
            else:
                far.append(label)
    return tuple(near), tuple(far)


def label_limit(check: LimitCheck, words: Vocabulary) -> str:
    """Format a limit and its verdict for a label."""
    limit = f"{check.format_limit()} {check.unit}"
    return f"{words.limits[check.metric]} ≤ {limit}, {check.verdict}"
