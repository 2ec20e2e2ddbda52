"""Limits in the plot over the frames: their lines, and labels that cover little."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from cageik_cli.report.limits import PERCENT, LimitCheck, format_limit, make_verdict
from cageik_cli.report.plots.placement import Box, place_boxes
from cageik_cli.report.plots.series import MIN_AXIS_PERCENT, Series
from cageik_cli.report.record import Report
from cageik_cli.report.vocabulary import Vocabulary, choose_vocabulary
from cageik_cli.util.arrays import Floats

LABEL_HEIGHT = 0.052
"""Height of a label; like all sizes of labels a share of the axes."""

LABEL_GAP = 0.008
"""Distance between a label and its line."""

EDGE_MARGIN = 0.012
"""Distance between a label and the sides of the axes."""

POSITION_COUNT = 9
"""Positions along a line that are tried."""

OVERLAP_COST, CROSSING_COST = 1000.0, 15.0
"""Cost of overlapping another label or leaving the axes, and of lying on another line; to cover a
point costs one."""

MAX_REACH = 2.5
"""Limits above this multiple of the highest value have no line; they are named above the plot."""

LETTER_WIDTH = 0.0101
"""Approximate width of a letter of a label, as a share of the axes."""

CURVE_SAMPLES = 600
"""Points of a curve that labels should not cover."""


@dataclass(frozen=True, slots=True, eq=False)
class LimitLine:
    """A limit that is drawn with a curve.

    Attributes
    ----------
    heights : tuple of float
        Percent; two of opposite sign if the limit applies on both sides of zero.
    """

    series: Series
    check: LimitCheck
    heights: tuple[float, ...]
    label: str


def build_limit_lines(report: Report, series: Series) -> tuple[list[LimitLine], list[LimitCheck]]:
    """Split the limits on a curve into those that are drawn and those far above it."""
    words = choose_vocabulary(report.edited_from)
    reach = MAX_REACH * np.nanmax(np.abs(series.values), initial=MIN_AXIS_PERCENT)
    to_percent = 100 / report.clip.diagonal
    near, far = [], []
    for check in report.gates:
        if check.metric in series.metrics:
            height = check.limit if check.unit == PERCENT else to_percent * check.limit
            if height <= reach:
                heights = (height, -height) if series.is_signed else (height,)
                near.append(LimitLine(series, check, heights, format_limit_label(check, words)))
            else:
                far.append(check)
    return near, far


def draw_limit_lines(axes: Axes, limits: Sequence[LimitLine]) -> None:
    """Draw limits as dashed lines on the axes of their curve, without labels."""
    for limit in limits:
        for height in limit.heights:
            axes.axhline(
                height, color=limit.series.style.colour, linewidth=0.9, dashes=(8, 4), gid="limit"
            )


def draw_limit_labels(
    drawn: tuple[tuple[Axes, Series], tuple[Axes, Series]],
    limits: Sequence[LimitLine],
    occupied: Box,
) -> None:
    """Label the limits, above or below their lines, where the labels cover little.

    Parameters
    ----------
    drawn : tuple
        The left axes, which are in front, and the right ones, each with its curve.
    limits : sequence of LimitLine
        The limits that have lines.
    occupied : Box
        A box that labels must not touch.
    """
    points = np.concatenate([_sample_curve(axes, series) for axes, series in drawn])
    labels = [
        Label(
            LETTER_WIDTH * len(limit.label),
            tuple(_axes_fractions(drawn[limit.series.side][0], limit.heights)),
            limit.series.side == 1,
        )
        for limit in limits
    ]
    levels = [level for label in labels for level in label.levels]
    front = drawn[0][0]
    for limit, box in zip(limits, place_labels(labels, points, levels, [occupied]), strict=True):
        is_right = limit.series.side == 1
        front.text(
            box[2 if is_right else 0],
            box[1],
            limit.label,
            transform=front.transAxes,
            ha="right" if is_right else "left",
            va="bottom",
            fontsize=7.5,
            color=limit.series.style.colour,
            bbox={"boxstyle": "square,pad=0.1", "fc": "white", "lw": 0, "alpha": 0.75},
        )


def format_limit_label(check: LimitCheck, words: Vocabulary) -> str:
    """Format a limit and its verdict for a label."""
    verdict = make_verdict(check).text
    return f"{words.limits[check.metric]} ≤ {format_limit(check)} {check.unit}, {verdict}"


def _sample_curve(axes: Axes, series: Series) -> Floats:
    """Sample points along a curve, (k, 2), as shares of the axes."""
    first, last = axes.get_xlim()
    numbers = np.linspace(series.numbers[0], series.numbers[-1], CURVE_SAMPLES)
    heights = np.interp(numbers, series.numbers, series.values)
    return np.stack([(numbers - first) / (last - first), _axes_fractions(axes, heights)], axis=1)


def _axes_fractions(axes: Axes, heights: Sequence[float] | Floats) -> list[float]:
    """Return heights as shares of the axes, from the lower end."""
    low, high = axes.get_ylim()
    return [float(height / (high - low) - low / (high - low)) for height in heights]


@dataclass(frozen=True, slots=True)
class Label:
    """A label to be placed.

    Attributes
    ----------
    levels : tuple of float
        Heights of its lines; it stands above or below one of them.
    prefers_right : bool
        Whether it stands on the right rather than on the left if both cost the same.
    """

    width: float
    levels: tuple[float, ...]
    prefers_right: bool


def place_labels(
    labels: Sequence[Label], points: Floats, levels: Sequence[float], occupied: Sequence[Box]
) -> list[Box]:
    """Place each label above or below one of its lines.

    Parameters
    ----------
    labels : sequence of Label
        The first labels choose first.
    points : (k, 2) float64
        Points of the curves; nan is left out.
    levels : sequence of float
        Heights of all lines.
    occupied : sequence of Box
        Boxes that labels must not touch.
    """
    candidates = (_candidate_boxes(label, levels) for label in labels)
    placed = place_boxes(candidates, points, occupied, OVERLAP_COST)
    return [box for box in placed if box is not None]


def _candidate_boxes(label: Label, levels: Sequence[float]) -> Iterator[tuple[float, Box]]:
    """Yield boxes at the label's lines with their costs, in order of preference."""
    last = max(1 - EDGE_MARGIN - label.width, EDGE_MARGIN)
    lefts = np.linspace(EDGE_MARGIN, last, POSITION_COUNT).tolist()
    for left in reversed(lefts) if label.prefers_right else lefts:
        for line in label.levels:
            for bottom in (line + LABEL_GAP, line - LABEL_GAP - LABEL_HEIGHT):
                top = bottom + LABEL_HEIGHT
                crossed = sum(bottom < level < top for level in levels)
                outside = bottom < 0 or top > 1
                cost = OVERLAP_COST * outside + CROSSING_COST * crossed
                yield cost, (left, bottom, left + label.width, top)
