"""The plot over the frames: the error, and the volume change or the largest deviation.

It does not depend on pyplot or the user's matplotlibrc; the same report gives the same bytes.
"""

import io
import re
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from cageik_cli.report.figures import ClipRecord, format_percent
from cageik_cli.report.limits import PERCENT, LimitCheck
from cageik_cli.report.plots.style import (
    CURVE_STYLES,
    PLOT_COLOURS,
    Box,
    make_drawable,
    place_limit_labels,
    use_fixed_style,
)
from cageik_cli.report.record import Report
from cageik_cli.report.render.shading import MIN_SCALE_PERCENT
from cageik_cli.report.vocabulary import Vocabulary
from cageik_cli.util.arrays import Floats

AXES_SIDES = {"left": 0.1, "bottom": 0.14, "right": 0.9, "top": 0.87}
"""Sides of the axes, as shares of the picture from its lower left corner."""

MAX_MARKED_FRAMES = 60
"""Clips with more frames have markers only at frames between gaps."""


def render_page_plot(report: Report) -> tuple[str, dict[str, float]]:
    """Render the plot of a report for a page.

    Returns
    -------
    svg : str
        One element without a fixed size; text stays text.
    places : dict of str to float
        `left`, `right`, `top` and `bottom` are the sides of its axes, as shares of the picture's
        width from the left and of its height from the top. `first` and `last` are the frames,
        counted from 0, at the left and right end of the axes; fractions, because of the margins
        beside the first and the last frame.
    """
    svg = render_plot_svg(report)
    svg = re.sub(r' width="[^"]*"| height="[^"]*"', "", svg[svg.index("<svg") :], count=2)
    first, last = _x_limits(len(report.frames))
    left, bottom, right, top = AXES_SIDES.values()
    sides = {"left": left, "right": right, "top": 1 - top, "bottom": 1 - bottom}
    return svg, sides | {"first": first, "last": last}


def render_plot_svg(report: Report) -> str:
    """Render the plot of a report as an SVG file."""
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    return _save_plot(report, "svg", nothing).decode()


def render_plot_png(report: Report) -> bytes:
    """Render the plot of a report as a PNG file, 1440 pixels wide."""
    return _save_plot(report, "png", {"Software": None})


def _save_plot(report: Report, kind: str, metadata: dict[str, None]) -> bytes:
    stream = io.BytesIO()
    with use_fixed_style():
        draw_plot(report).savefig(stream, format=kind, dpi=200, metadata=metadata)
    return stream.getvalue()


def draw_plot(report: Report) -> Figure:
    """Draw the error of each frame, and its volume change or its largest deviation.

    The deviation is drawn if the model is open, or no frame has a volume. Skipped frames are shaded
    gaps.
    """
    error, other = build_series(report)
    figure = Figure((7.2, 3.6))
    figure.subplots_adjust(**AXES_SIDES)
    left = figure.add_subplot()
    right = left.twinx()
    left.set(zorder=right.get_zorder() + 1, frame_on=False)
    _draw_gaps(right, error.values, report.clip)
    curves = ((left, error), (right, other))
    for axes, series in curves:
        _draw_series(axes, series)
        _set_y_limits(axes, series)
        for height in (height for _, lines in series.limits for height in lines):
            axes.axhline(
                height, color=series.style["color"], linewidth=0.9, dashes=(8, 4), gid="limit"
            )
    left.axhline(
        report.summary.rms_percent,
        color=error.style["color"],
        linewidth=0.7,
        label=f"RMS of the clip {format_percent(report.summary.rms_percent)} %",
        gid="clip",
    )
    worst = _draw_worst_frame(left, error, report)
    for axes, series in curves:
        _label_axes(axes, series, report)
    _draw_legend(figure, curves)
    _draw_limit_labels(curves, worst)
    return figure


def _x_limits(count: int) -> tuple[float, float]:
    """Return the ends of the axes of a clip with `count` frames, counted from 0."""
    room = max(0.5, 0.01 * count)
    return -room, count - 1 + room


def _draw_gaps(axes: Axes, values: Floats, clip: ClipRecord) -> None:
    """Shade the skipped frames."""
    runs = [
        list(frames)
        for is_gap, frames in groupby(range(len(values)), lambda k: bool(np.isnan(values[k])))
        if is_gap
    ]
    if runs:
        axes.broken_barh(
            [(clip.frame_number(run[0] - 0.5), len(run) * clip.frame_step) for run in runs],
            (0, 1),
            transform=axes.get_xaxis_transform(),
            color=PLOT_COLOURS["gap"],
            linewidth=0,
            label="skipped",
            zorder=0,
        )


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


def _draw_series(axes: Axes, series: Series) -> None:
    drawn: Any = {"linewidth": 1.4, "markersize": 3.2}
    # All frames of a short clip have a marker, otherwise those between gaps.
    is_marked = np.isfinite(series.values)
    if len(is_marked) > MAX_MARKED_FRAMES:
        padded = np.pad(is_marked, 1)
        is_marked = is_marked & ~padded[:-2] & ~padded[2:]
    axes.plot(
        series.numbers, series.values, **series.style, **drawn,
        markevery=np.flatnonzero(is_marked).tolist(), label=series.label, gid=series.metric,
    )  # fmt: skip
    before = series.unfitted
    if before is not None:
        style = before.style
        if len(before.numbers) > MAX_MARKED_FRAMES:
            style["marker"] = ""
        axes.plot(
            before.numbers, before.values, **style, **drawn, label=before.label, gid=before.metric
        )
    if series.is_signed:
        axes.axhline(0, color=series.style["color"], linewidth=0.5, dashes=(1, 3), gid="zero")


def _set_y_limits(axes: Axes, series: Series) -> None:
    """Set the axes so that zero, all values and the limits are inside."""
    heights = [height for _, lines in series.limits for height in lines]
    if series.unfitted is not None:
        heights += series.unfitted.values.tolist()
    lowest = float(np.nanmin(series.values, initial=min([0.0, *heights])))
    highest = float(np.nanmax(series.values, initial=max([0.0, *heights])))
    size = max(highest - lowest, MIN_SCALE_PERCENT)
    # A quarter above the highest value is room for the label of the worst frame.
    axes.set_ylim(lowest - 0.08 * size if lowest < 0 else 0, lowest + 1.25 * size)


def _draw_worst_frame(axes: Axes, series: Series, report: Report) -> Box:
    """Ring and label the worst frame on the side with room; return the box of the label."""
    summary, count = report.summary, len(report.frames)
    worst = summary.worst_frame_index
    place = (series.numbers[worst], series.values[worst])
    column = int(np.digitize(worst / count, (0.3, 0.7)))
    side = ("left", "center", "right")[column]
    text = (
        f"{report.vocabulary.worst} "
        f"{format_percent(summary.worst_frame_rms_percent)} %, {make_drawable(summary.worst_frame)}"
    )
    axes.plot(
        *place,
        "o",
        markersize=7.5,
        markerfacecolor="none",
        markeredgecolor=PLOT_COLOURS["ink"],
        gid="worst",
    )
    axes.annotate(
        text,
        place,
        xytext=(place[0], 0.99),
        textcoords=axes.get_xaxis_transform(),
        ha=side,
        va="top",
        fontsize=8.5,
        arrowprops={
            "arrowstyle": "-",
            "color": PLOT_COLOURS["muted"],
            "linewidth": 0.7,
            "shrinkB": 4,
            "relpos": (column / 2, 0),
        },
    )
    first, last = _x_limits(count)
    width, at = 0.0115 * len(text), (worst - first) / (last - first)  # width of a letter, about
    return at - width * column / 2, 0.92, at + width * (1 - column / 2), 1.0


def _label_axes(axes: Axes, series: Series, report: Report) -> None:
    """Label the axes and set their ticks."""
    axes.set_xlim(*map(report.clip.frame_number, _x_limits(len(report.frames))))
    axes.set_xlabel(f"frame of {make_drawable(report.result)}")
    axes.set_ylabel(series.axis_label, color=series.style["color"])
    axes.tick_params(axis="y", labelcolor=series.style["color"], color=series.style["color"])
    axes.xaxis.set_major_locator(MaxNLocator(10, integer=True, min_n_ticks=1, steps=[1, 2, 5, 10]))
    axes.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}".replace("-", "−")))
    axes.spines["top"].set_visible(False)


def _draw_legend(figure: Figure, curves: Sequence[tuple[Axes, Series]]) -> None:
    """Explain the lines above the axes, and name the limits that have no line."""
    left, top = AXES_SIDES["left"], AXES_SIDES["top"]
    drawn = [axes.get_legend_handles_labels() for axes, _ in curves]
    figure.legend(
        [handle for handles, _ in drawn for handle in handles],
        [label for _, labels in drawn for label in labels],
        loc="upper left",
        bbox_to_anchor=(left, 1.0),
        ncols=4,
        fontsize=8.5,
        frameon=False,
        handlelength=2.8,
        columnspacing=1.6,
        borderpad=0.6,
        borderaxespad=0,
    )
    undrawn = [label for _, series in curves for label in series.undrawn_limits]
    if undrawn:
        text = "limits without a line: " + "; ".join(undrawn)
        text = textwrap.shorten(text, 100, placeholder=" …")
        colour = PLOT_COLOURS["muted"]
        figure.text(left, top + 0.015, text, fontsize=7.5, color=colour, gid="not-drawn")


def _draw_limit_labels(curves: Sequence[tuple[Axes, Series]], occupied: Box) -> None:
    """Label the limits, above or below their lines, where the labels cover little.

    The left axes come first, and are in front. Labels do not touch the box `occupied`, in shares of
    the axes.
    """
    points = np.concatenate([_sample_curve(axes, series) for axes, series in curves])
    limits = [
        (text, _to_shares(axes, heights), axes is not curves[0][0], series.style["color"])
        for axes, series in curves
        for text, heights in series.limits
    ]
    # A letter has about this share of the axes' width.
    labels = [(0.0101 * len(text), lines, is_right) for text, lines, is_right, _ in limits]
    levels = [height for _, lines, _ in labels for height in lines]
    boxes, front = place_limit_labels(labels, points, levels, occupied), curves[0][0]
    for (text, _, is_right, colour), box in zip(limits, boxes, strict=True):
        front.text(
            box[2 if is_right else 0], box[1], text, transform=front.transAxes,
            ha="right" if is_right else "left", va="bottom", fontsize=7.5, color=colour,
            bbox={"boxstyle": "square,pad=0.1", "fc": "white", "lw": 0, "alpha": 0.75},
        )  # fmt: skip


def _sample_curve(axes: Axes, series: Series) -> Floats:
    """Sample points along a curve, (k, 2), as shares of the axes."""
    count = 600  # so close that no label fits between two
    first, last = axes.get_xlim()
    numbers = np.linspace(series.numbers[0], series.numbers[-1], count)
    heights = np.interp(numbers, series.numbers, series.values)
    return np.stack([(numbers - first) / (last - first), _to_shares(axes, heights)], axis=1)


def _to_shares(axes: Axes, heights: Sequence[float] | Floats) -> list[float]:
    """Return heights as shares of the axes, from the lower end."""
    low, high = axes.get_ylim()
    return [float(height / (high - low) - low / (high - low)) for height in heights]


MAX_LIMIT_REACH = 2.5
"""A limit has a line up to this many times the highest value of the curve."""


def build_series(report: Report) -> tuple[Series, Series]:
    """Build the curves of the error and of the volume change.

    The largest deviation replaces the volume change if the model is open, or no frame has one.
    """
    frames, words = report.frames, report.vocabulary
    numbers = np.array([frame.number for frame in frames], np.float64)
    errors = _make_plottable(frame.rms_percent for frame in frames)
    limits, undrawn = _split_limits(report, ("rms", "frame_rms"), errors)
    before = None
    if report.unfitted is not None:
        before = Series(
            "unfitted",
            numbers[list(report.unfitted.frames)],
            _make_plottable(report.unfitted.rms_percent),
            report.unfitted.coordinates,
        )
    error = Series(
        metric="rms",
        numbers=numbers,
        values=errors,
        label=f"RMS {words.measure}" + (", fitted" if report.unfitted else ""),
        axis_label=f"RMS {words.measure}, % of the diagonal",
        limits=limits,
        undrawn_limits=undrawn,
        unfitted=before,
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
