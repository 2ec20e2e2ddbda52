import numpy as np
import pytest

from cageik_cli.geometry import neighbours
from cageik_cli.geometry.neighbours import measure_distances, order_by_place


@pytest.mark.parametrize("limit", [0, 10_000_000])
@pytest.mark.parametrize("block", [1, 700, 50_000])
def test_distances_from_points_are_those_of_all_pairs(monkeypatch, limit, block):
    places, points = np.random.default_rng(3).normal(size=(2, 70, 3))
    monkeypatch.setattr(neighbours, "MAX_COMPARED_PAIRS", limit)
    monkeypatch.setattr(neighbours, "PAIRS_PER_BLOCK", block)
    expected = np.linalg.norm(points[:, None] - places, axis=2).min(axis=1)
    np.testing.assert_allclose(measure_distances(places, points), expected, rtol=1e-14, atol=0)


def test_the_order_by_place_has_each_point_once_and_small_blocks():
    points = np.random.default_rng(0).uniform(size=(4096, 3))
    order = order_by_place(points)
    np.testing.assert_array_equal(np.sort(order), np.arange(4096))
    sizes = np.ptp(points[order].reshape(64, 64, 3), axis=1).max(axis=1)
    # 64 points of 4096 fill a cube of a quarter of the side, and often lie in two.
    assert sizes.mean() < 0.55
    assert np.ptp(points.reshape(64, 64, 3), axis=1).max(axis=1).mean() > 0.9


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.ones((5, 3)), np.full((1, 3), 1e50)])
def test_points_at_one_place_keep_their_order(points):
    np.testing.assert_array_equal(order_by_place(points), np.arange(len(points)))
