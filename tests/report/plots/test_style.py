"""Plots do not depend on the user's settings, and labels take the cheapest box."""

from itertools import combinations

import matplotlib as mpl
import numpy as np
import pytest

from cageik_cli.report.plots.style import (
    DEFAULT_MAX_LENGTH,
    make_drawable,
    measure_text_width,
    place_boxes,
    place_limit_labels,
    place_names,
    use_fixed_style,
)


def test_matplotlib_settings_of_the_user_are_ignored_and_restored():
    with mpl.rc_context({"font.size": 31.0, "axes.facecolor": "red"}):
        with use_fixed_style():
            assert mpl.rcParams["font.size"] == 9.0
            assert mpl.rcParams["axes.facecolor"] == "white"
        assert mpl.rcParams["font.size"] == 31.0


@pytest.mark.slow
@pytest.mark.parametrize("module", ["error_plot", "model_plot"])
def test_pyplot_is_not_imported(run_process, module):
    code = (
        f"import sys, cageik_cli.report.plots.{module}; print('matplotlib.pyplot' in sys.modules)"
    )
    assert run_process("-c", code).out == "False\n"


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("walk_01.obj", "walk_01.obj"),
        ("a\nb\ud800", "a\ufffdb\ufffd"),
        ("x" * DEFAULT_MAX_LENGTH, "x" * DEFAULT_MAX_LENGTH),
        ("", ""),
    ],
)
def test_letters_that_the_font_lacks_are_replaced(name, expected):
    assert make_drawable(name) == expected


@pytest.mark.parametrize("longest", [20, DEFAULT_MAX_LENGTH])
def test_long_names_keep_their_ends(longest):
    text = make_drawable("first" + "x" * 100 + "last", longest)
    assert len(text) <= longest
    assert text.startswith("first")
    assert text.endswith("last")


def test_widths_grow_with_letters_and_their_size():
    assert measure_text_width("", 10) == 0
    assert 4 * measure_text_width("m", 10) == pytest.approx(measure_text_width("mmmm", 10), rel=0.1)
    assert 2 * measure_text_width("mile", 10) == pytest.approx(
        measure_text_width("mile", 20), rel=0.1
    )
    assert measure_text_width("iiii", 10) < measure_text_width("mmmm", 10)


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


@pytest.mark.parametrize(
    ("candidates", "occupied", "placed"),
    [
        # Boxes that touch do not overlap; a label that can only overlap is left out.
        ([[(0, (1.0, 0.0, 2.0, 1.0))]], [LEFT], [(1.0, 0.0, 2.0, 1.0)]),
        ([[(0, LEFT)], [(0, LEFT)], [(0, RIGHT)]], [], [LEFT, None, RIGHT]),
        ([[]], [], [None]),
    ],
)
def test_boxes_do_not_overlap(candidates, occupied, placed):
    assert place_boxes(candidates, NO_POINTS, occupied) == placed


@pytest.mark.parametrize(
    ("occupied", "cost", "box"),
    [([LEFT], 8.0, LEFT), ([LEFT], 10.0, RIGHT), ([LEFT, LEFT], 8.0, RIGHT)],
)
def test_a_finite_cost_of_overlaps_is_paid_if_nothing_is_cheaper(occupied, cost, box):
    assert place_boxes([[(0, LEFT), (9, RIGHT)]], NO_POINTS, occupied, cost) == [box]


HEIGHT, GAP, MARGIN = 0.05, 0.01, 0.02
"""Of labels of limits, as shares of the axes."""

NOWHERE = (2.0, 2.0, 3.0, 3.0)


def placed_limits(labels, points, levels, occupied=NOWHERE):
    sizes = {"height": HEIGHT, "gap": GAP, "margin": MARGIN}
    return place_limit_labels(labels, points, levels, occupied, **sizes)


def meet(one, other):
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


@pytest.mark.parametrize(("from_right", "left"), [(False, MARGIN), (True, 1 - MARGIN - 0.3)])
def test_a_single_label_is_above_its_line_on_its_own_side(from_right, left):
    (box,) = placed_limits([(0.3, (0.5,), from_right)], NO_POINTS, [0.5])
    assert box == pytest.approx((left, 0.5 + GAP, left + 0.3, 0.5 + GAP + HEIGHT))


def test_a_label_avoids_curves_lines_and_the_upper_end():
    curve = np.stack([np.linspace(0, 0.5, 100), np.full(100, 0.53)], axis=1)
    (beside,) = placed_limits([(0.3, (0.5,), False)], curve, [0.5, 0.46])
    assert beside[0] >= 0.5
    (below,) = placed_limits([(0.3, (0.5,), False)], NO_POINTS, [0.5, 0.53])
    assert below[3] == pytest.approx(0.5 - GAP)
    (inside,) = placed_limits([(0.3, (0.99,), False)], NO_POINTS, [0.99])
    assert inside[3] < 0.99


def test_a_label_of_two_lines_is_at_the_free_one():
    (box,) = placed_limits([(0.9, (0.8, 0.2), False)], NO_POINTS, [0.8, 0.2], (0, 0.7, 1, 0.9))
    assert box[1] == pytest.approx(0.2 + GAP)


def test_labels_do_not_overlap():
    labels = [(0.3, (0.5 + 0.03 * k,), k % 2 == 1) for k in range(6)]
    boxes = placed_limits(labels, NO_POINTS, [0.5], (0.0, 0.5, 0.1, 0.6))
    assert len(boxes) == 6
    assert not any(meet(one, other) for k, one in enumerate(boxes) for other in boxes[:k])
    assert not any(meet(one, (0.0, 0.5, 0.1, 0.6)) for one in boxes)


def test_a_label_wider_than_the_axes_starts_at_the_left():
    (box,) = placed_limits([(1.5, (0.5,), True)], np.full((3, 2), np.nan), [0.5])
    assert box[0] == MARGIN


SIDE = 100.0


def placed_names(dots, size=(20.0, 8.0), points=NO_POINTS):
    dots = np.array(dots, float).reshape(-1, 2)
    return place_names(dots, np.tile(size, (len(dots), 1)), np.asarray(points, float), SIDE)


@pytest.mark.parametrize(
    ("dot", "points", "left"), [((50, 50), NO_POINTS, 58), ((95, 50), [(95, 50)], 67)]
)
def test_a_name_is_to_the_right_of_its_dot_or_to_the_left_at_the_edge(dot, points, left):
    (box,) = placed_names([dot], points=points)
    assert box == pytest.approx((left, 46, left + 20, 54))


def test_a_name_covers_no_points_if_it_can():
    line = np.column_stack([np.linspace(55, 90, 20), np.full(20, 50.0)])
    (box,) = placed_names([(50, 50)], points=line)
    left, top, right, bottom = box
    x, y = line.T
    assert not ((left < x) & (x < right) & (top < y) & (y < bottom)).any()


@pytest.mark.parametrize("spread", [0.0, 5.0, 40.0])
def test_names_do_not_overlap_or_leave_the_picture(spread):
    dots = 50 + spread * np.random.default_rng(3).uniform(-1.3, 1.3, (40, 2))
    boxes = [box for box in placed_names(dots) if box is not None]
    assert len(boxes) >= 8
    for left, top, right, bottom in boxes:
        assert 3.0 <= left < right <= SIDE - 3.0 + 1e-9
        assert 3.0 <= top < bottom <= SIDE - 3.0 + 1e-9
    for (a, b, c, d), (e, f, g, h) in combinations(boxes, 2):
        assert a >= g or e >= c or b >= h or f >= d


def test_a_name_without_room_is_left_out():
    assert placed_names([(50, 50)], size=(99.0, 8.0)) == [None]
    assert placed_names(20 * [(50, 50)], size=(60.0, 30.0)).count(None) >= 16
    assert placed_names([]) == []
