"""Where labels of level lines stand in a figure, so that they hide little and do not meet.

All places are shares of the axes, from their lower left corner.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

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
