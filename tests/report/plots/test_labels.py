"""Labels of limits: beside their lines, off the curves, and without overlaps."""

import numpy as np
import pytest

from cageik_cli.report.plots.limit_lines import (
    EDGE_MARGIN,
    LABEL_GAP,
    LABEL_HEIGHT,
    Label,
    place_labels,
)

NOTHING = np.empty((0, 2))


def meet(one, other):
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


@pytest.mark.parametrize(
    ("from_right", "left"), [(False, EDGE_MARGIN), (True, 1 - EDGE_MARGIN - 0.3)]
)
def test_a_single_label_is_above_its_line_on_its_own_side(from_right, left):
    (box,) = place_labels([Label(0.3, (0.5,), from_right)], NOTHING, [0.5], [])
    assert box == pytest.approx((left, 0.5 + LABEL_GAP, left + 0.3, 0.5 + LABEL_GAP + LABEL_HEIGHT))


def test_a_label_avoids_curves_lines_and_the_upper_end():
    curve = np.stack([np.linspace(0, 0.5, 100), np.full(100, 0.53)], axis=1)
    (beside,) = place_labels([Label(0.3, (0.5,), False)], curve, [0.5, 0.46], [])
    assert beside[0] >= 0.5
    (below,) = place_labels([Label(0.3, (0.5,), False)], NOTHING, [0.5, 0.53], [])
    assert below[3] == pytest.approx(0.5 - LABEL_GAP)
    (inside,) = place_labels([Label(0.3, (0.99,), False)], NOTHING, [0.99], [])
    assert inside[3] < 0.99


def test_a_label_of_two_lines_is_at_the_free_one():
    (box,) = place_labels([Label(0.9, (0.8, 0.2), False)], NOTHING, [0.8, 0.2], [(0, 0.7, 1, 0.9)])
    assert box[1] == pytest.approx(0.2 + LABEL_GAP)


def test_labels_do_not_overlap():
    labels = [Label(0.3, (0.5 + 0.03 * k,), k % 2 == 1) for k in range(6)]
    boxes = place_labels(labels, NOTHING, [0.5], [(0.0, 0.5, 0.1, 0.6)])
    assert len(boxes) == 6
    assert not any(meet(one, other) for k, one in enumerate(boxes) for other in boxes[:k])
    assert not any(meet(one, (0.0, 0.5, 0.1, 0.6)) for one in boxes)


def test_a_label_wider_than_the_axes_starts_at_the_left():
    (box,) = place_labels([Label(1.5, (0.5,), True)], np.full((3, 2), np.nan), [0.5], [])
    assert box[0] == EDGE_MARGIN
