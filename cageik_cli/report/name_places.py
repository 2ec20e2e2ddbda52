"""Where names stand beside dots in a picture, so that they hide little and do not meet.

All lengths are in one unit, x to the right and y downwards from the picture's upper left corner.
"""

from collections.abc import Iterator

import numpy as np

from cageik_cli.report.labels import Box
from cageik_cli.util.arrays import Floats

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
