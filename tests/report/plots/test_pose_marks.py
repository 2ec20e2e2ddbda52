"""Names are beside their dots, inside the picture, without overlaps, and cover little."""

from itertools import combinations

import numpy as np
import pytest

from cageik_cli.report.plots.pose_marks import EDGE_MARGIN, NAME_GAPS, place_names

SIDE = 100.0
NOTHING = np.empty((0, 2))


def placed(dots, size=(20.0, 8.0), points=NOTHING):
    dots = np.array(dots, float).reshape(-1, 2)
    return place_names(dots, np.tile(size, (len(dots), 1)), np.asarray(points, float), SIDE)


def test_a_name_is_to_the_right_of_its_dot():
    (box,) = placed([(50, 50)])
    assert box == pytest.approx((50 + NAME_GAPS[0], 46, 70 + NAME_GAPS[0], 54))


def test_a_name_at_the_right_edge_is_to_the_left():
    (box,) = placed([(95, 50)], points=[(95, 50)])
    assert box == pytest.approx((75 - NAME_GAPS[0], 46, 95 - NAME_GAPS[0], 54))


def test_a_name_covers_no_points_if_it_can():
    line = np.column_stack([np.linspace(55, 90, 20), np.full(20, 50.0)])
    (box,) = placed([(50, 50)], points=line)
    left, top, right, bottom = box
    x, y = line.T
    assert not ((left < x) & (x < right) & (top < y) & (y < bottom)).any()


@pytest.mark.parametrize("spread", [0.0, 5.0, 40.0])
def test_names_do_not_overlap_or_leave_the_picture(spread):
    dots = 50 + spread * np.random.default_rng(3).uniform(-1.3, 1.3, (40, 2))
    boxes = [box for box in placed(dots) if box is not None]
    assert len(boxes) >= 8
    for left, top, right, bottom in boxes:
        assert EDGE_MARGIN <= left < right <= SIDE - EDGE_MARGIN + 1e-9
        assert EDGE_MARGIN <= top < bottom <= SIDE - EDGE_MARGIN + 1e-9
    for (a, b, c, d), (e, f, g, h) in combinations(boxes, 2):
        assert a >= g or e >= c or b >= h or f >= d


def test_a_name_without_room_is_left_out():
    assert placed([(50, 50)], size=(99.0, 8.0)) == [None]
    assert placed(20 * [(50, 50)], size=(60.0, 30.0)).count(None) >= 16


def test_no_dots_have_no_names():
    assert placed([]) == []
