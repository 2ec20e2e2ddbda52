"""Limits in the figure over the frames: their lines, and labels that hide little."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from cageik_cli.report.limits import PERCENT, Gate, gate_verdict, most_text
from cageik_cli.report.plots.series import LEAST, Series
from cageik_cli.report.record import Report
from cageik_cli.report.vocabulary import Wording, wording_of
from cageik_cli.util.arrays import Floats

HEIGHT = 0.052
"""Of a label."""

CLEAR = 0.008
"""Between a label and its line."""

EDGE = 0.012
"""Between a label and the sides of the axes."""

STEPS = 9
"""Places along a line that are tried."""

MEETS, CROSSES = 1000.0, 15.0
"""What it costs to meet another label or leave the axes, and to lie on another line; to hide a
point costs one."""

Box = tuple[float, float, float, float]
"""Left, bottom, right, top."""


@dataclass(frozen=True, slots=True)
class Label:
    """What is to be placed.

    Attributes
    ----------
    width : float
    levels : tuple of float
        Heights of the lines that it may stand at, one of them.
    from_right : bool
        Whether it is to be to the right rather than to the left, where both are as good.
    """

    width: float
    levels: tuple[float, ...]
    from_right: bool


def placed(
    labels: Sequence[Label], points: Floats, levels: Sequence[float], taken: Sequence[Box]
) -> list[Box]:
    """A place for each label, above or below one of its lines.

    Parameters
    ----------
    labels : sequence of Label
        The first have the first choice.
    points : (k, 2) float64
        Of the curves; nan is left out.
    levels : sequence of float
        Heights of all lines.
    taken : sequence of Box
        Where no label can be.
    """
    boxes = list(taken)
    for label in labels:
        boxes.append(min(_candidates(label), key=lambda box: _cost(box, points, levels, boxes)))
    return boxes[len(taken) :]


def _candidates(label: Label) -> Iterator[Box]:
    """The best first."""
    lefts = np.linspace(EDGE, max(1 - EDGE - label.width, EDGE), STEPS).tolist()
    for left in reversed(lefts) if label.from_right else lefts:
        for level in label.levels:
            for bottom in (level + CLEAR, level - CLEAR - HEIGHT):
                yield left, bottom, left + label.width, bottom + HEIGHT


def _cost(box: Box, points: Floats, levels: Sequence[float], boxes: Sequence[Box]) -> float:
    left, bottom, right, top = box
    x, y = points.T
    hidden = np.count_nonzero((left < x) & (x < right) & (bottom < y) & (y < top))
    crossed = sum(bottom < level < top for level in levels)
    met = sum(a < right and left < c and b < top and bottom < d for a, b, c, d in boxes)
    met += bottom < 0 or top > 1
    return MEETS * met + CROSSES * crossed + float(hidden)


REACH = 2.5
"""A limit is drawn up to so many times as high as the highest figure; beyond it is named alone."""

LETTER = 0.0101
"""How wide letters of labels are, about, as a share of the axes."""

SAMPLES = 600
"""Points of a line that labels keep clear of."""


@dataclass(frozen=True, slots=True, eq=False)
class LimitLine:
    """A limit that is drawn with a series.

    Attributes
    ----------
    series : Series
    gate : Gate
    heights : tuple of float
        Of its lines, one or, on both sides of zero, two, in percent.
    label : str
    """

    series: Series
    gate: Gate
    heights: tuple[float, ...]
    label: str


def limit_lines(report: Report, series: Series) -> tuple[list[LimitLine], list[Gate]]:
    """The limits on a series that are drawn, and those far above it."""
    words = wording_of(report.edited_from)
    reach = REACH * np.nanmax(np.abs(series.values), initial=LEAST)
    to_percent = 100 / report.clip.diagonal
    near, far = [], []
    for gate in report.gates:
        if gate.metric in series.metrics:
            height = gate.limit if gate.unit == PERCENT else to_percent * gate.limit
            if height <= reach:
                heights = (height, -height) if series.is_signed else (height,)
                near.append(LimitLine(series, gate, heights, limit_label(gate, words)))
            else:
                far.append(gate)
    return near, far


def draw_lines(axes: Axes, limits: Sequence[LimitLine]) -> None:
    """Draw limits on the axes of their series, dashed, without their labels."""
    for limit in limits:
        for height in limit.heights:
            axes.axhline(
                height, color=limit.series.look.colour, linewidth=0.9, dashes=(8, 4), gid="limit"
            )


def draw_labels(
    drawn: tuple[tuple[Axes, Series], tuple[Axes, Series]],
    limits: Sequence[LimitLine],
    taken: Box,
) -> None:
    """Name the limits, above the lines of both axes and where they hide little.

    Parameters
    ----------
    drawn : tuple
        The left axes, which are in front, and the right ones, each with its series.
    limits : sequence of LimitLine
        Those that are drawn.
    taken : Box
        Where no label can be.
    """
    points = np.concatenate([_points(axes, series) for axes, series in drawn])
    labels = [
        Label(
            LETTER * len(limit.label),
            tuple(_shares(drawn[limit.series.side][0], limit.heights)),
            limit.series.side == 1,
        )
        for limit in limits
    ]
    levels = [level for label in labels for level in label.levels]
    front = drawn[0][0]
    for limit, box in zip(limits, placed(labels, points, levels, [taken]), strict=True):
        is_right = limit.series.side == 1
        front.text(
            box[2 if is_right else 0],
            box[1],
            limit.label,
            transform=front.transAxes,
            ha="right" if is_right else "left",
            va="bottom",
            fontsize=7.5,
            color=limit.series.look.colour,
            bbox={"boxstyle": "square,pad=0.1", "fc": "white", "lw": 0, "alpha": 0.75},
        )


def limit_label(gate: Gate, words: Wording) -> str:
    """A limit and its verdict, as short as a label is to be."""
    verdict = gate_verdict(gate).text
    return f"{words.limits[gate.metric]} ≤ {most_text(gate)} {gate.unit}, {verdict}"


def _points(axes: Axes, series: Series) -> Floats:
    """Places along a line, (k, 2), as shares of the axes."""
    first, last = axes.get_xlim()
    frames = np.linspace(0, len(series.values) - 1, SAMPLES)
    heights = np.interp(frames, np.arange(len(series.values)), series.values)
    return np.stack([(frames - first) / (last - first), _shares(axes, heights)], axis=1)


def _shares(axes: Axes, heights: Sequence[float] | Floats) -> list[float]:
    """Where heights are between the lower and the upper end of the axes."""
    low, high = axes.get_ylim()
    return [float(height / (high - low) - low / (high - low)) for height in heights]
