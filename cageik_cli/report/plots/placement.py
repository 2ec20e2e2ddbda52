"""Placement of labels in a plot: one after the other, each where it costs least."""

from collections.abc import Iterable, Sequence

import numpy as np

from cageik_cli.util.arrays import Floats

Box = tuple[float, float, float, float]
"""Low x, low y, high x, high y."""


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
    boxes = list(occupied)
    placed: list[Box | None] = []
    for label in candidates:
        costs = [
            (cost + _cost_overlaps(box, boxes, overlap_cost) + _count_covered(box, points), box)
            for cost, box in label
        ]
        best = min(costs, key=lambda one: one[0], default=(np.inf, None))
        box = best[1] if best[0] < np.inf else None
        placed.append(box)
        boxes += [] if box is None else [box]
    return placed


def _cost_overlaps(box: Box, others: Sequence[Box], overlap_cost: float) -> float:
    left, low, right, high = box
    count = sum(a < right and left < c and b < high and low < d for a, b, c, d in others)
    return overlap_cost * count if count else 0.0


def _count_covered(box: Box, points: Floats) -> int:
    left, low, right, high = box
    x, y = points.T
    return int(np.count_nonzero((left < x) & (x < right) & (low < y) & (y < high)))
