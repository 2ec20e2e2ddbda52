"""The marks of a picture of a pose: anchors, arrows to their targets, and rings around these.

Places are points of the figure, 72 to the inch, x to the right and y downwards.
"""

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from cageik_cli.report.plots.limit_lines import Box
from cageik_cli.report.plots.style import INK, MUTED
from cageik_cli.util.arrays import Floats

Flags = NDArray[np.bool_]

SMALL = 8.0
"""Size of letters."""

MOVED = "#c8321f"

KINDS = ((False, MOVED, "o"), (True, INK, "s"))
"""Whether it is pinned, and the colour and mark of such an anchor."""

DOT, RING = 6.0, 11.0
"""Across marks: anchors, and the targets around them."""

AROUND = RING / 2 * np.array([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)])
"""What a mark covers: points from its middle."""

COVERED = 0.5
"""Opacity of marks behind the model."""

SHAFT, HEAD, HEAD_WIDTH = 1.9, 9.0, 7.0
"""Of an arrow."""

LEAST = 1.0
"""Shorter arrows (those towards the viewer, say) and smaller misses of pins are not drawn."""


def draw_arrows(axes: Axes, starts: Floats, ends: Floats) -> None:
    """Draw an arrow from each place to another, (k, 2)."""
    for start, end in zip(starts, ends, strict=True):
        along = end - start
        length = float(np.hypot(*along))
        if length < LEAST:
            continue
        head = min(HEAD, 0.6 * length)
        share = head / HEAD
        along = along / length
        neck = end - head * along
        across = share * np.array([-along[1], along[0]])
        shaft, barb = SHAFT / 2 * across, HEAD_WIDTH / 2 * across
        outline = [start + shaft, neck + shaft, neck + barb, end]
        outline += [neck - barb, neck - shaft, start - shaft]
        arrow = Polygon(np.array(outline), facecolor=MOVED, zorder=3, gid="arrow")
        arrow.set(edgecolor="white", linewidth=0.6, joinstyle="miter")
        axes.add_patch(arrow)


def draw_goals(axes: Axes, dots: Floats, goals: Floats, pinned: Flags) -> None:
    """Ring the targets, with a line to where what was to go there is, if that can be seen.

    Those of pins are ringed only if they are missed.
    """
    misses = np.linalg.norm(dots - goals, axis=1)
    for is_pin, colour, marker in KINDS:
        kind = (pinned == is_pin) & (misses >= (LEAST if is_pin else 0))
        axes.plot(
            *goals[kind].T,
            marker,
            markersize=RING,
            markerfacecolor="none",
            markeredgecolor=colour,
            markeredgewidth=1.1,
            path_effects=[withStroke(linewidth=2.8, foreground="white")],
            zorder=4,
            gid="goal",
        )
        for line in np.stack([dots, goals], axis=1)[kind & (misses > RING / 2)]:
            axes.plot(*line.T, color=colour, linewidth=1.0, dashes=(3, 1.5), zorder=4, gid="miss")


def draw_dots(axes: Axes, dots: Floats, pinned: Flags, covered: Flags) -> None:
    """Mark the anchors, (l, 2), those behind the model paler."""
    for is_pin, colour, marker in KINDS:
        for is_covered in (True, False):
            axes.plot(
                *dots[(pinned == is_pin) & (covered == is_covered)].T,
                marker,
                markersize=DOT,
                color=colour,
                markeredgecolor="white",
                markeredgewidth=0.7,
                alpha=COVERED if is_covered else 1.0,
                zorder=5,
                gid="pin" if is_pin else "dot",
            )


def draw_legend(figure: Figure, pinned: Flags) -> None:
    """Say below all panels what the marks are."""
    marks = []
    if not pinned.all():
        marks += [(MOVED, "o", DOT, MOVED, "handle"), (MOVED, "o", RING, "none", "its target")]
    if pinned.any():
        marks += [(INK, "s", DOT, INK, "pinned")]
    figure.legend(
        [
            Line2D([], [], linestyle="", color=colour, marker=marker, ms=size, mfc=inside)
            for colour, marker, size, inside, _ in marks
        ],
        [label for *_, label in marks],
        loc="lower center",
        ncols=len(marks) or 1,
        fontsize=SMALL,
        labelcolor=MUTED,
        frameon=False,
        handletextpad=0.1,
        columnspacing=1.4,
        borderpad=0.5,
        borderaxespad=0.5,
    )


GAPS = (8.0, 14.0, 21.0)
"""Between a dot and its name; the nearest is the best."""

SIDES = ((1, 0), (-1, 0), (0, -1), (0, 1), (1, -1), (-1, -1), (1, 1), (-1, 1))
"""Of a dot where its name may stand: to the right or left, above or below."""

EDGE = 3.0
"""Between a name and the sides of the picture."""

AWAY = 2.0
"""Points that a name may hide rather than stand one gap further away."""


def name_places(dots: Floats, sizes: Floats, hidden: Floats, side: float) -> list[Box | None]:
    """A place beside its dot for each name, in a square picture; None where there is no room.

    Parameters
    ----------
    dots : (k, 2) float64
        The first have the first choice.
    sizes : (k, 2) float64
        Of the names, across and down.
    hidden : (p, 2) float64
        What is better not covered.
    side : float
        Of the picture.

    Returns
    -------
    list of (left, top, right, bottom)
    """
    boxes: list[Box | None] = []
    for dot, size in zip(dots, sizes, strict=True):
        held = [box for box in boxes if box is not None]
        free = [box for box in _candidates(dot, size, side) if not _meets(box[1], held)]
        best = min(free, key=lambda one: one[0] + _covered(one[1], hidden), default=None)
        boxes.append(None if best is None else best[1])
    return boxes


def _candidates(dot: Floats, size: Floats, side: float) -> Iterator[tuple[float, Box]]:
    """Boxes beside a dot with what each costs, the best first; none leaves the picture."""
    if (size > side - 2 * EDGE).any():
        return
    for step, gap in enumerate(GAPS):
        for place, (right, down) in enumerate(SIDES):
            towards = np.array([right, down]) * (1.0 if 0 in (right, down) else np.sqrt(0.5))
            middle = dot + towards * gap + np.array([right, down]) * size / 2
            low = np.clip(middle - size / 2, EDGE, side - EDGE - size)
            left, top, end, bottom = (float(value) for value in (*low, *(low + size)))
            yield AWAY * step + 0.01 * place, (left, top, end, bottom)


def _covered(box: Box, points: Floats) -> int:
    left, top, right, bottom = box
    x, y = points.T
    return int(np.count_nonzero((left < x) & (x < right) & (top < y) & (y < bottom)))


def _meets(box: Box, others: list[Box]) -> bool:
    left, top, right, bottom = box
    return any(a < right and left < c and b < bottom and top < d for a, b, c, d in others)
