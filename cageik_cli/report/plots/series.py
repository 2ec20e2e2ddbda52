"""The two curves of the plot over the frames: the error, and volume change or deviation."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cageik_cli.report.record import Report
from cageik_cli.report.unfitted import UnfittedRecord
from cageik_cli.report.vocabulary import choose_vocabulary
from cageik_cli.util.arrays import Floats

MIN_AXIS_PERCENT = 0.001
"""Percent; no axis ends lower, so that rounding does not look like an error."""

MAX_PLOTTED_PERCENT = 1e150
"""Larger values are clamped; matplotlib cannot draw their axes."""


@dataclass(frozen=True, slots=True)
class LineStyle:
    """Style of a line, in matplotlib's terms."""

    colour: str
    linestyle: str | tuple[int, tuple[float, ...]]
    marker: str


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """A second curve on the axis of a series, over some of the frames.

    Attributes
    ----------
    numbers : (k,) float64
        Of these frames.
    values : (k,) float64
        Percent.
    label : str
        In the legend.
    """

    numbers: Floats
    values: Floats
    label: str
    style: LineStyle


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """A curve over the frames: its values and its style.

    Attributes
    ----------
    numbers : (F,) float64
        Of the frames.
    values : (F,) float64
        Percent; nan in gaps.
    name : str
        Name and unit, with a comma between them.
    metrics : tuple of str
        Metrics whose limits are drawn with the curve.
    side : int
        Its axis: 0 for left, 1 for right.
    label : str
        In the legend.
    reference : Reference, optional
        The same measure with the weights before a fit.
    """

    numbers: Floats
    values: Floats
    name: str
    metrics: tuple[str, ...]
    side: int
    style: LineStyle
    label: str
    reference: Reference | None = None

    @property
    def is_signed(self) -> bool:
        """Whether limits apply on both sides of zero."""
        return self.metrics == ("volume_change",)


def build_series(report: Report) -> tuple[Series, Series]:
    """Build the curves of the error and of the volume change.

    The largest deviation replaces the volume change if the model is open, or no frame has one.
    """
    frames, words = report.frames, choose_vocabulary(report.edited_from)
    numbers = np.array([frame.number for frame in frames], np.float64)
    error = Series(
        numbers,
        _plottable_values([frame.rms_percent for frame in frames]),
        f"RMS {words.measure}, % of the diagonal",
        ("rms", "frame_rms"),
        0,
        LineStyle("#0a7d4b", "-", "o"),
        f"RMS {words.measure}" + (", fitted" if report.unfitted else ""),
        _build_reference(report.unfitted, numbers),
    )
    changes = [frame.volume_change for frame in frames]
    if report.clip.closed and any(change is not None for change in changes):
        style = LineStyle("#1f4fa3", (0, (3.4, 1.1)), "s")
        return error, Series(
            numbers,
            _plottable_values(changes),
            "volume change, %",
            ("volume_change",),
            1,
            style,
            "volume change",
        )
    deviations = _plottable_values([frame.max_deviation_percent for frame in frames])
    name = f"{words.largest}, % of the diagonal"
    style = LineStyle("#8a3a8f", (0, (4, 1, 1, 1)), "^")
    return error, Series(numbers, deviations, name, ("max_deviation",), 1, style, words.largest)


def _build_reference(unfitted: UnfittedRecord | None, numbers: Floats) -> Reference | None:
    """Build the curve of the weights before a fit."""
    if unfitted is None:
        return None
    return Reference(
        numbers[list(unfitted.frames)],
        _plottable_values(unfitted.rms_percent),
        unfitted.coordinates,
        LineStyle("#c0641c", (0, (1.2, 1.2)), "d"),
    )


def _plottable_values(metrics: Sequence[float | None]) -> Floats:
    values = np.array([np.nan if value is None else value for value in metrics])
    return np.asarray(np.clip(values, -MAX_PLOTTED_PERCENT, MAX_PLOTTED_PERCENT))
