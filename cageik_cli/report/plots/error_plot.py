"""The plot over the frames: the error, and the volume change or the largest deviation.

It does not depend on pyplot or the user's matplotlibrc; the same report gives the same bytes.
"""

import io
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from cageik_cli.report.figures import ClipRecord, format_percent
from cageik_cli.report.plots.limit_lines import (
    LimitLine,
    build_limit_lines,
    draw_limit_labels,
    draw_limit_lines,
    format_limit_label,
)
from cageik_cli.report.plots.placement import Box
from cageik_cli.report.plots.series import MIN_AXIS_PERCENT, Reference, Series, build_series
from cageik_cli.report.plots.style import INK, MUTED, make_drawable, use_fixed_style
from cageik_cli.report.record import Report
from cageik_cli.report.vocabulary import choose_vocabulary
from cageik_cli.util.arrays import Floats, Integers

FIGURE_SIZE, DPI = (7.2, 3.6), 200
"""Width and height in inches, and pixels per inch."""

LEFT, RIGHT, BOTTOM, TOP = 0.1, 0.9, 0.14, 0.87
"""Sides of the axes, as shares of the picture from its lower left corner."""

GAP_COLOUR = "#eceef0"

HEADROOM = 1.25
"""Height of the axes, in heights of the highest value; leaves room for the worst frame's label."""

MAX_MARKED_FRAMES = 60
"""Clips with more frames have markers only at frames between gaps."""

LETTER_WIDTH = 0.0115
"""Approximate width of a letter of the worst frame's label, as a share of the axes."""

MAX_UNDRAWN_LETTERS = 100
"""Letters of the line that names limits without a line in the plot."""


@dataclass(frozen=True, slots=True)
class PagePlot:
    """The plot for a page.

    Attributes
    ----------
    svg : str
        One element without a fixed size; text stays text.
    left, right, top, bottom : float
        Sides of its axes, as shares of the picture's width from the left and of its height from
        the top.
    first, last : float
        Frames, counted from 0, at the left and right end of the axes; fractions, because of the
        margins beside the first and the last frame.
    """

    svg: str
    left: float
    right: float
    top: float
    bottom: float
    first: float
    last: float


def build_page_plot(report: Report) -> PagePlot:
    """Render the plot of a report for a page."""
    first, last = _x_limits(len(report.frames))
    svg = render_plot_svg(report)
    svg = re.sub(r' width="[^"]*"| height="[^"]*"', "", svg[svg.index("<svg") :], count=2)
    return PagePlot(svg, LEFT, RIGHT, 1 - TOP, 1 - BOTTOM, first, last)


def render_plot_svg(report: Report) -> str:
    """Render the plot of a report as an SVG file."""
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    return _save_plot(report, "svg", nothing).decode()


def render_plot_png(report: Report) -> bytes:
    """Render the plot of a report as a PNG file, 1440 pixels wide."""
    return _save_plot(report, "png", {"Software": None})


def draw_plot(report: Report) -> Figure:
    """Draw the error of each frame, and its volume change or its largest deviation.

    The deviation is drawn if the model is open, or no frame has a volume. Skipped frames are shaded
    gaps.
    """
    with use_fixed_style():
        return _draw_plot(report)


def _save_plot(report: Report, kind: str, metadata: dict[str, None]) -> bytes:
    stream = io.BytesIO()
    with use_fixed_style():
        _draw_plot(report).savefig(stream, format=kind, dpi=DPI, metadata=metadata)
    return stream.getvalue()


def _draw_plot(report: Report) -> Figure:
    error, other = build_series(report)
    figure = Figure(FIGURE_SIZE)
    figure.subplots_adjust(LEFT, BOTTOM, RIGHT, TOP)
    left = figure.add_subplot()
    right = left.twinx()
    left.set(zorder=right.get_zorder() + 1, frame_on=False)
    _draw_gaps(right, error.values, report.clip)
    undrawn, drawn_limits = [], []
    for axes, series in ((left, error), (right, other)):
        _draw_series(axes, series)
        near, far = build_limit_lines(report, series)
        _set_y_limits(axes, series, near)
        draw_limit_lines(axes, near)
        drawn_limits += near
        undrawn += far
    _draw_clip_rms(left, error, report)
    worst = _draw_worst_frame(left, error, report)
    _label_axes(left, error, report)
    _label_axes(right, other, report)
    undrawn += [
        check for check in report.gates if check.metric not in error.metrics + other.metrics
    ]
    words = choose_vocabulary(report.edited_from)
    _draw_legend(figure, (left, right), [format_limit_label(check, words) for check in undrawn])
    draw_limit_labels(((left, error), (right, other)), drawn_limits, worst)
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
            color=GAP_COLOUR,
            linewidth=0,
            label="skipped",
            zorder=0,
        )


def _draw_series(axes: Axes, series: Series) -> None:
    axes.plot(
        series.numbers,
        series.values,
        linestyle=series.style.linestyle,
        color=series.style.colour,
        linewidth=1.4,
        marker=series.style.marker,
        markersize=3.2,
        markevery=_marked_frames(series.values).tolist(),
        label=series.label,
        gid=series.metrics[0],
    )
    if series.reference is not None:
        _draw_reference(axes, series.reference)
    if series.is_signed:
        axes.axhline(0, color=series.style.colour, linewidth=0.5, dashes=(1, 3), gid="zero")


def _draw_reference(axes: Axes, reference: Reference) -> None:
    few = len(reference.numbers) <= MAX_MARKED_FRAMES
    axes.plot(
        reference.numbers,
        reference.values,
        linestyle=reference.style.linestyle,
        color=reference.style.colour,
        linewidth=1.4,
        marker=reference.style.marker if few else "",
        markersize=3.2,
        label=reference.label,
        gid="unfitted",
    )


def _marked_frames(values: Floats) -> Integers:
    """Return the frames with a marker: all of a short clip, otherwise those between gaps."""
    known = np.isfinite(values)
    if len(values) <= MAX_MARKED_FRAMES:
        return np.flatnonzero(known)
    padded = np.pad(known, 1)
    return np.flatnonzero(known & ~padded[:-2] & ~padded[2:])


def _set_y_limits(axes: Axes, series: Series, limits: Sequence[LimitLine]) -> None:
    """Set the axes so that zero, all values and the limits are inside."""
    heights = [height for limit in limits for height in limit.heights]
    if series.reference is not None:
        heights += series.reference.values.tolist()
    lowest = float(np.nanmin(series.values, initial=min([0.0, *heights])))
    highest = float(np.nanmax(series.values, initial=max([0.0, *heights])))
    size = max(highest - lowest, MIN_AXIS_PERCENT)
    axes.set_ylim(lowest - 0.08 * size if lowest < 0 else 0, lowest + HEADROOM * size)


def _draw_clip_rms(axes: Axes, series: Series, report: Report) -> None:
    axes.axhline(
        report.summary.rms_percent,
        color=series.style.colour,
        linewidth=0.7,
        label=f"RMS of the clip {format_percent(report.summary.rms_percent)} %",
        gid="clip",
    )


def _draw_worst_frame(axes: Axes, series: Series, report: Report) -> Box:
    """Ring and label the worst frame on the side with room; return the box of the label."""
    summary, count = report.summary, len(report.frames)
    worst = summary.worst_frame_index
    place = (series.numbers[worst], series.values[worst])
    column = int(np.digitize(worst / count, (0.3, 0.7)))
    side = ("left", "center", "right")[column]
    text = (
        f"{choose_vocabulary(report.edited_from).worst} "
        f"{format_percent(summary.worst_frame_rms_percent)} %, {make_drawable(summary.worst_frame)}"
    )
    axes.plot(*place, "o", markersize=7.5, markerfacecolor="none", markeredgecolor=INK, gid="worst")
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
            "color": MUTED,
            "linewidth": 0.7,
            "shrinkB": 4,
            "relpos": (column / 2, 0),
        },
    )
    first, last = _x_limits(count)
    width, at = LETTER_WIDTH * len(text), (worst - first) / (last - first)
    return at - width * column / 2, 0.92, at + width * (1 - column / 2), 1.0


def _label_axes(axes: Axes, series: Series, report: Report) -> None:
    """Label the axes and set their ticks."""
    axes.set_xlim(*map(report.clip.frame_number, _x_limits(len(report.frames))))
    axes.set_xlabel(f"frame of {make_drawable(report.result)}")
    axes.set_ylabel(series.name, color=series.style.colour)
    axes.tick_params(axis="y", labelcolor=series.style.colour, color=series.style.colour)
    axes.xaxis.set_major_locator(MaxNLocator(10, integer=True, min_n_ticks=1, steps=[1, 2, 5, 10]))
    axes.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    axes.yaxis.set_major_formatter(FuncFormatter(_format_tick))
    axes.spines["top"].set_visible(False)


def _format_tick(value: float, _: int | None) -> str:
    return f"{value:g}".replace("-", "−")


def _draw_legend(figure: Figure, axes_pair: tuple[Axes, Axes], undrawn_limits: list[str]) -> None:
    """Explain the lines above the axes, and name the limits that have no line."""
    drawn = [axes.get_legend_handles_labels() for axes in axes_pair]
    figure.legend(
        [handle for handles, _ in drawn for handle in handles],
        [label for _, labels in drawn for label in labels],
        loc="upper left",
        bbox_to_anchor=(LEFT, 1.0),
        ncols=4,
        fontsize=8.5,
        frameon=False,
        handlelength=2.8,
        columnspacing=1.6,
        borderpad=0.6,
        borderaxespad=0,
    )
    if undrawn_limits:
        text = "limits without a line: " + "; ".join(undrawn_limits)
        text = textwrap.shorten(text, MAX_UNDRAWN_LETTERS, placeholder=" …")
        figure.text(LEFT, TOP + 0.015, text, fontsize=7.5, color=MUTED, gid="not-drawn")
