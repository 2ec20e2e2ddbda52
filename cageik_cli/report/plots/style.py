"""What plots share: colours and fonts, whatever the user's matplotlibrc says, and where labels go.

Labels are placed one after the other, each where it costs least. To cover a point costs one, which
is the unit of all costs.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import matplotlib.style
import numpy as np
from matplotlib.font_manager import FontProperties, findfont, get_font

from cageik_cli.util.arrays import Floats

PLOT_COLOURS = {"ink": "#20242a", "muted": "#59626d", "gap": "#eceef0", "handle": "#c8321f"}
"""Colours of texts, of axes, of skipped frames, and of handles with their targets."""

CURVE_STYLES: dict[str, Any] = {
    "rms": {"color": "#0a7d4b", "linestyle": "-", "marker": "o"},
    "unfitted": {"color": "#c0641c", "linestyle": (0, (1.2, 1.2)), "marker": "d"},
    "volume_change": {"color": "#1f4fa3", "linestyle": (0, (3.4, 1.1)), "marker": "s"},
    "max_deviation": {"color": "#8a3a8f", "linestyle": (0, (4, 1, 1, 1)), "marker": "^"},
}
"""How the curves of the error plot look, by metric; `rms` is the error of a frame."""

PANEL_SIDE = 345.6
"""Width and height of the picture of a model in a plot, in points, 72 per inch."""

DEFAULT_MAX_LENGTH = 40
"""Characters of a name that are shown; longer names are cut in the middle."""


Box = tuple[float, float, float, float]
"""Low x, low y, high x, high y."""


@contextmanager
def use_fixed_style() -> Iterator[None]:
    """Set the style in which plots are drawn and saved."""
    settings: Any = {
        "font.size": 9.0,
        "axes.edgecolor": PLOT_COLOURS["muted"],
        "axes.linewidth": 0.8,
        "axes.unicode_minus": True,
        "path.simplify": False,
        "text.color": PLOT_COLOURS["ink"],
        "text.parse_math": False,
        "xtick.color": PLOT_COLOURS["muted"],
        "svg.fonttype": "none",
        "svg.hashsalt": "cageik",
    }
    with matplotlib.style.context("default"), mpl.rc_context(settings):
        yield


def make_drawable(name: str, max_length: int = DEFAULT_MAX_LENGTH) -> str:
    """Cut a long name, and replace letters that the font does not have."""
    font = get_font(findfont(FontProperties()))
    text = "".join(letter if font.get_char_index(ord(letter)) else "\ufffd" for letter in name)
    if len(text) <= max_length:
        return text
    return f"{text[: max_length // 2 - 1]}…{text[-max_length // 2 :]}"


def measure_text_width(text: str, size: float) -> float:
    """Return the width of a text in letters of this size, both in points."""
    font = get_font(findfont(FontProperties()))
    font.set_size(size, 72)
    font.set_text(text)
    return float(font.get_width_height()[0] / 64)


def place_boxes(
    candidates: Iterable[Iterable[tuple[float, Box]]],
    points: Floats,
    occupied: Sequence[Box] = (),
    overlap_cost: float = np.inf,
) -> list[Box | None]:
    """Choose the cheapest candidate for each label; the first labels choose first.

    A candidate costs its own cost, one for each point that it covers, and `overlap_cost` for each
    box that it overlaps.

    Parameters
    ----------
    candidates : iterable of iterable of (cost, Box)
        The candidates of each label; of equal ones the first is taken.
    points : (k, 2) float64
        Points that should stay visible; nan is left out.
    occupied : sequence of Box
        Boxes that are there already.

    Returns
    -------
    list of Box or None
        None where every candidate costs infinitely much.
    """
    boxes, (x, y) = list(occupied), points.T
    placed: list[Box | None] = []
    for label in candidates:
        costs = []
        for cost, one in label:
            left, low, right, high = one
            overlaps = sum(a < right and left < c and b < high and low < d for a, b, c, d in boxes)
            covered = (left < x) & (x < right) & (low < y) & (y < high)
            cost += overlap_cost * overlaps if overlaps else 0.0
            costs.append((cost + np.count_nonzero(covered), one))
        best = min(costs, key=lambda found: found[0], default=(np.inf, None))
        box = best[1] if best[0] < np.inf else None
        placed.append(box)
        boxes += [] if box is None else [box]
    return placed


def place_limit_labels(
    labels: Sequence[tuple[float, Sequence[float], bool]],
    points: Floats,
    levels: Sequence[float],
    occupied: Box,
    *,
    height: float = 0.052,
    gap: float = 0.008,
    margin: float = 0.012,
) -> list[Box]:
    """Place each label of a limit above or below one of its lines; lengths are shares of the axes.

    Parameters
    ----------
    labels : sequence of (float, sequence of float, bool)
        The width of each label, the heights of its lines, and whether it stands on the right rather
        than on the left if both cost the same.
    points : (k, 2) float64
        Points of the curves, which should stay visible; nan is left out.
    levels : sequence of float
        Heights of all lines, which labels should not lie on.
    occupied : Box
        A box that labels must not touch.
    height : float
        Of a label.
    gap, margin : float
        Distances between a label and its line, and the sides of the axes.
    """
    overlap_cost, crossing_cost = 1000.0, 15.0

    def list_candidates(
        width: float, lines: Sequence[float], prefers_right: bool
    ) -> Iterator[tuple[float, Box]]:
        lefts = np.linspace(margin, max(1 - margin - width, margin), 9).tolist()
        for left in reversed(lefts) if prefers_right else lefts:
            for line in lines:
                for bottom in (line + gap, line - gap - height):
                    top = bottom + height
                    crossed = sum(bottom < level < top for level in levels)
                    is_outside = bottom < 0 or top > 1
                    cost = overlap_cost * is_outside + crossing_cost * crossed
                    yield cost, (left, bottom, left + width, top)

    candidates = (list_candidates(*label) for label in labels)
    placed = place_boxes(candidates, points, [occupied], overlap_cost)
    return [box for box in placed if box is not None]


def place_names(
    dots: Floats,
    sizes: Floats,
    points: Floats,
    side: float,
    *,
    gaps: Sequence[float] = (8.0, 14.0, 21.0),
) -> list[Box | None]:
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
    gaps : sequence of float
        Distances between a dot and its name, the best first.
    """
    margin = 3.0  # between a name and the sides of the picture, points
    # The best first: right, left, above, below, then the corners.
    sides = ((1, 0), (-1, 0), (0, -1), (0, 1), (1, -1), (-1, -1), (1, 1), (-1, 1))

    def list_candidates(dot: Floats, size: Floats) -> Iterator[tuple[float, Box]]:
        if (size > side - 2 * margin).any():
            return
        for step, gap in enumerate(gaps):
            for number, (right, down) in enumerate(sides):
                towards = np.array([right, down]) * (1.0 if 0 in (right, down) else np.sqrt(0.5))
                middle = dot + towards * gap + np.array([right, down]) * size / 2
                low = np.clip(middle - size / 2, margin, side - margin - size)
                left, top, end, bottom = (float(value) for value in (*low, *(low + size)))
                yield 2.0 * step + 0.01 * number, (left, top, end, bottom)

    return place_boxes((list_candidates(*one) for one in zip(dots, sizes, strict=True)), points)
