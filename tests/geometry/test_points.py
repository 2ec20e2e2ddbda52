"""Order, distances and enclosing spheres of points."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cageik_cli.geometry.points import (
    choose_farthest,
    measure_distances,
    order_by_place,
    smallest_enclosing_sphere,
)
from tests.shapes import TETRAHEDRON, ball, box, rotation


@pytest.mark.parametrize("limit", [0, 10_000_000])
@pytest.mark.parametrize("block", [1, 700, 50_000])
def test_distances_from_points_are_those_of_all_pairs(limit, block):
    places, points = np.random.default_rng(3).normal(size=(2, 70, 3))
    expected = np.linalg.norm(points[:, None] - places, axis=2).min(axis=1)
    np.testing.assert_allclose(
        measure_distances(places, points, limit, block), expected, rtol=1e-14, atol=0
    )


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


@pytest.mark.parametrize(
    ("points", "radius"),
    [
        (box(2.0).vertices, np.sqrt(12)),
        (ball(3, 1.5).vertices, 1.5),
        ([[3, 4, 5]], 0.0),
        ([[3, 4, 5]] * 7, 0.0),
        ([[0, 0, 0], [4, 0, 0], [1, 0, 0], [2, 0, 0]], 2.0),
        ([[0, 0, 0], [4, 0, 0], [2, 0.1, 0]], 2.0),
        ([[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0]], np.sqrt(1 / 3)),
    ],
)
def test_known_spheres(points, radius):
    points = np.asarray(points, float)
    centre, found = smallest_enclosing_sphere(points)
    assert found == pytest.approx(radius, rel=1e-12, abs=0)
    assert np.linalg.norm(points - centre, axis=1).max() <= found * (1 + 1e-12)


def smallest_of_all(points):
    """Oracle: the smallest of all spheres through 2 to 4 of the points that hold all."""
    best = np.inf
    for count in (2, 3, 4):
        for chosen in combinations(points, count):
            sides = np.array(chosen[1:]) - chosen[0]
            centre = chosen[0] + np.linalg.pinv(2 * sides) @ (sides**2).sum(axis=1)
            best = min(best, np.linalg.norm(points - centre, axis=1).max())
    return best


@given(st.integers(0, 10_000), st.integers(2, 12), st.sampled_from([1e-100, 1.0, 1e100]))
def test_the_sphere_is_the_smallest(seed, count, scale):
    generator = np.random.default_rng(seed)
    points = generator.normal(size=(count, 3)) * generator.choice([1, 1, 1e-3], 3)
    assert smallest_enclosing_sphere(scale * points)[1] == pytest.approx(
        scale * smallest_of_all(points), rel=1e-10
    )


def test_the_radius_does_not_depend_on_the_axes():
    points = np.random.default_rng(0).normal(size=(2000, 3)) * [1, 2, 3]
    radii = [smallest_enclosing_sphere(points @ rotation(k).T + k)[1] for k in range(5)]
    np.testing.assert_allclose(radii, radii[0], rtol=1e-12, atol=0)


def test_a_regular_body_with_many_points_on_its_sphere_ends():
    sphere = np.random.default_rng(1).normal(size=(5000, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    points = np.vstack([sphere, TETRAHEDRON.vertices * 1e-3])
    assert smallest_enclosing_sphere(points)[1] == pytest.approx(1.0, abs=1e-6)


def test_the_farthest_are_chosen_one_after_another():
    points = np.array([0.0, 1.0, 4.0, 4.0, 9.0])
    chosen = choose_farthest(9, np.abs(points), lambda k: np.abs(points - points[k]))
    assert chosen == [4, 2, 1]
