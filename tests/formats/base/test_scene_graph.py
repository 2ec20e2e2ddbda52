"""Polygons and transforms of scenes."""

import numpy as np
import pytest

from cageik_cli.formats.base.scene_graph import (
    Polygons,
    describe_transform,
    is_mirroring,
    transform_points,
)
from cageik_cli.util.errors import InputError

POINTS = np.arange(15.0).reshape(5, 3)
MIXED = Polygons(np.array([3, 4]), np.array([0, 1, 2, 1, 2, 3, 4]))


def test_polygons_become_fans_of_either_winding():
    assert MIXED.make_mesh(POINTS, is_clockwise=False).faces.tolist() == [
        [0, 1, 2],
        [1, 2, 3],
        [1, 3, 4],
    ]
    assert MIXED.make_mesh(POINTS, is_clockwise=True).faces.tolist() == [
        [2, 1, 0],
        [4, 3, 2],
        [4, 2, 1],
    ]


@pytest.mark.parametrize("counts", [[], [3], [3, 5], [-3, 10], [2**62, 2**62]])
def test_counts_that_do_not_fit_the_corners_are_refused(counts):
    with pytest.raises(InputError, match="corners, found 7"):
        Polygons(np.array(counts, np.int64), MIXED.corners).make_mesh(POINTS, is_clockwise=False)


def test_polygons_differ_by_counts_or_corners():
    assert not MIXED.differs_from(Polygons(MIXED.corner_counts.copy(), MIXED.corners.copy()))
    assert MIXED.differs_from(Polygons(np.array([4, 3]), MIXED.corners))
    assert MIXED.differs_from(Polygons(MIXED.corner_counts, MIXED.corners[::-1]))


def test_rows_are_multiplied_with_the_matrix():
    matrix = np.eye(4)
    matrix[:3, :3], matrix[3, :3] = np.diag([2, 3, 4]), [1, 1, 1]
    np.testing.assert_array_equal(transform_points(POINTS, matrix), POINTS * [2, 3, 4] + 1)


def test_what_is_not_moved_keeps_every_bit():
    tiny = np.array([[1e-300, -0.0, 1e300]])
    np.testing.assert_array_equal(transform_points(tiny, np.eye(4)), tiny)


@pytest.mark.parametrize(("scales", "mirror"), [([1, 1, -1], True), ([-1, -1, 1], False)])
def test_mirrors(scales, mirror):
    assert is_mirroring(np.diag([*scales, 1.0])) == mirror


def test_only_what_moves_is_noted():
    assert describe_transform(np.eye(4), False) == []
    assert describe_transform(np.diag([2.0, 1, 1, 1]), False) == [
        "moved by its transform into the scene's space"
    ]
    assert describe_transform(np.eye(4), True) == [
        "moved by its animated transform into the scene's space"
    ]
