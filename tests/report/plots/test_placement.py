"""Labels take the cheapest box: preferences, covered points and overlaps have costs."""

import numpy as np

from cageik_cli.report.plots.placement import place_boxes

NO_POINTS = np.empty((0, 2))
LEFT, RIGHT = (0.0, 0.0, 1.0, 1.0), (2.0, 0.0, 3.0, 1.0)


def test_the_first_of_equal_candidates_is_taken():
    assert place_boxes([[(0, LEFT), (0, RIGHT)]], NO_POINTS) == [LEFT]


def test_a_covered_point_costs_one():
    candidates = [[(0, LEFT), (0.5, RIGHT)]]
    inside, outside, unknown = np.array([[[0.5, 0.5]], [[0.5, 1.5]], [[np.nan, 0.5]]])
    assert place_boxes(candidates, inside) == [RIGHT]
    assert place_boxes(candidates, outside) == [LEFT]
    assert place_boxes(candidates, unknown) == [LEFT]


def test_boxes_that_touch_do_not_overlap():
    beside = (1.0, 0.0, 2.0, 1.0)
    assert place_boxes([[(0, beside)]], NO_POINTS, [LEFT]) == [beside]


def test_a_label_that_can_only_overlap_is_left_out():
    assert place_boxes([[(0, LEFT)], [(0, LEFT)], [(0, RIGHT)]], NO_POINTS) == [LEFT, None, RIGHT]
    assert place_boxes([[]], NO_POINTS) == [None]


def test_a_finite_cost_of_overlaps_is_paid_if_nothing_is_cheaper():
    assert place_boxes([[(0, LEFT), (9, RIGHT)]], NO_POINTS, [LEFT], 8.0) == [LEFT]
    assert place_boxes([[(0, LEFT), (9, RIGHT)]], NO_POINTS, [LEFT], 10.0) == [RIGHT]
    assert place_boxes([[(0, LEFT), (9, RIGHT)]], NO_POINTS, [LEFT, LEFT], 8.0) == [RIGHT]
