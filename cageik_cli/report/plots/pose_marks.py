"""The marks of a plot of a pose: anchors, arrows to their targets, and rings around targets.

Positions are in points of the figure, 72 per inch, x to the right and y downwards.
"""

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from cageik_cli.report.plots.placement import Box, place_boxes
from cageik_cli.report.plots.style import INK, MUTED
from cageik_cli.util.arrays import Floats

Flags = NDArray[np.bool_]

LEGEND_FONT_SIZE = 8.0
"""Points."""

HANDLE_COLOUR = "#c8321f"

ANCHOR_STYLES = ((False, HANDLE_COLOUR, "o"), (True, INK, "s"))
"""Whether an anchor is pinned, its colour and its marker."""

DOT_SIZE, RING_SIZE = 6.0, 11.0
"""Diameters of the marks of anchors, and of the rings of targets."""

MARK_OFFSETS = RING_SIZE / 2 * np.array([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)])
"""Points that a mark covers, relative to its centre."""

COVERED_OPACITY = 0.5
"""Opacity of marks behind the model."""

SHAFT_WIDTH, HEAD_LENGTH, HEAD_WIDTH = 1.9, 9.0, 7.0
"""Sizes of an arrow."""

MIN_DRAWN_LENGTH = 1.0
"""Shorter arrows (for example towards the viewer) and smaller misses of pins are not drawn."""


def draw_arrows(axes: Axes, starts: Floats, ends: Floats) -> None:
    """Draw an arrow from each start to its end, (k, 2)."""
    for start, end in zip(starts, ends, strict=True):
        along = end - start
        length = float(np.hypot(*along))
        if length < MIN_DRAWN_LENGTH:
            continue
        head = min(HEAD_LENGTH, 0.6 * length)
        share = head / HEAD_LENGTH
        along = along / length
        neck = end - head * along
        across = share * np.array([-along[1], along[0]])
        shaft, barb = SHAFT_WIDTH / 2 * across, HEAD_WIDTH / 2 * across
        outline = [start + shaft, neck + shaft, neck + barb, end]
        outline += [neck - barb, neck - shaft, start - shaft]
        arrow = Polygon(np.array(outline), facecolor=HANDLE_COLOUR, zorder=3, gid="arrow")
        arrow.set(edgecolor="white", linewidth=0.6, joinstyle="miter")
        axes.add_patch(arrow)


def draw_targets(axes: Axes, dots: Floats, targets: Floats, pinned: Flags) -> None:
    """Ring the targets, with a dashed line to their anchors if those are outside the ring.

    Targets of pins are ringed only if they are missed.
    """
    misses = np.linalg.norm(dots - targets, axis=1)
    for is_pin, colour, marker in ANCHOR_STYLES:
        kind = (pinned == is_pin) & (misses >= (MIN_DRAWN_LENGTH if is_pin else 0))
        axes.plot(
            *targets[kind].T,
            marker,
            markersize=RING_SIZE,
            markerfacecolor="none",
            markeredgecolor=colour,
            markeredgewidth=1.1,
            path_effects=[withStroke(linewidth=2.8, foreground="white")],
            zorder=4,
            gid="goal",
        )
        for line in np.stack([dots, targets], axis=1)[kind & (misses > RING_SIZE / 2)]:
            axes.plot(*line.T, color=colour, linewidth=1.0, dashes=(3, 1.5), zorder=4, gid="miss")


def draw_anchors(axes: Axes, dots: Floats, pinned: Flags, covered: Flags) -> None:
    """Mark the anchors, (l, 2); those behind the model are paler."""
    for is_pin, colour, marker in ANCHOR_STYLES:
        for is_covered in (True, False):
            axes.plot(
                *dots[(pinned == is_pin) & (covered == is_covered)].T,
                marker,
                markersize=DOT_SIZE,
                color=colour,
                markeredgecolor="white",
                markeredgewidth=0.7,
                alpha=COVERED_OPACITY if is_covered else 1.0,
                zorder=5,
                gid="pin" if is_pin else "dot",
            )


def draw_legend(figure: Figure, pinned: Flags) -> None:
    """Explain the marks below all panels."""
    marks = []
    if not pinned.all():
        marks += [
            (HANDLE_COLOUR, "o", DOT_SIZE, HANDLE_COLOUR, "handle"),
            (HANDLE_COLOUR, "o", RING_SIZE, "none", "target"),
        ]
    if pinned.any():
        marks += [(INK, "s", DOT_SIZE, INK, "pin")]
    figure.legend(
        [
            Line2D([], [], linestyle="", color=colour, marker=marker, ms=size, mfc=inside)
            for colour, marker, size, inside, _ in marks
        ],
        [label for *_, label in marks],
        loc="lower center",
        ncols=len(marks) or 1,
        fontsize=LEGEND_FONT_SIZE,
        labelcolor=MUTED,
        frameon=False,
        handletextpad=0.1,
        columnspacing=1.4,
        borderpad=0.5,
        borderaxespad=0.5,
    )


NAME_GAPS = (8.0, 14.0, 21.0)
"""Distances between a dot and its name; the smallest is the best."""

NAME_SIDES = ((1, 0), (-1, 0), (0, -1), (0, 1), (1, -1), (-1, -1), (1, 1), (-1, 1))
"""Sides of a dot for its name, the best first: right, left, above, below, then the corners."""

EDGE_MARGIN = 3.0
"""Distance between a name and the sides of the picture."""

GAP_STEP_COST = 2.0
"""Cost of the next larger gap; to cover a point costs one."""


def place_names(dots: Floats, sizes: Floats, points: Floats, side: float) -> list[Box | None]:
    """Place each name beside its dot in a square picture; None where there is no room.

    Parameters
    ----------
    dots : (k, 2) float64
        The first names choose first.
    sizes : (k, 2) float64
        Widths and heights of the names.
    points : (p, 2) float64
        Points that should stay visible.
    side : float
        Size of the picture.
    """
    return place_boxes(
        (_candidate_boxes(dot, size, side) for dot, size in zip(dots, sizes, strict=True)), points
    )


def _candidate_boxes(dot: Floats, size: Floats, side: float) -> Iterator[tuple[float, Box]]:
    """Yield boxes beside a dot with their costs, the best first; all are inside the picture."""
    if (size > side - 2 * EDGE_MARGIN).any():
        return
    for step, gap in enumerate(NAME_GAPS):
        for number, (right, down) in enumerate(NAME_SIDES):
            towards = np.array([right, down]) * (1.0 if 0 in (right, down) else np.sqrt(0.5))
            middle = dot + towards * gap + np.array([right, down]) * size / 2
            low = np.clip(middle - size / 2, EDGE_MARGIN, side - EDGE_MARGIN - size)
            left, top, end, bottom = (float(value) for value in (*low, *(low + size)))
            yield GAP_STEP_COST * step + 0.01 * number, (left, top, end, bottom)
