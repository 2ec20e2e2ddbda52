import numpy as np
import pytest
import trimesh

from cageik_cli.geometry import surface
from cageik_cli.geometry.surface import (
    closest_points,
    measure_distances,
    winding_numbers,
)
from tests.shapes import ball, box, concave


def test_nearest_point_of_a_box_is_that_of_the_formula():
    points = np.random.default_rng(0).uniform(-2, 2, (200, 3))
    nearest = closest_points(box(), points)
    outside = np.linalg.norm(np.maximum(np.abs(points) - 1, 0), axis=1)
    depth = 1 - np.abs(points).max(axis=1)
    expected = np.where(depth > 0, depth, outside)
    np.testing.assert_allclose(nearest.distance, expected, atol=1e-12)


@pytest.mark.parametrize("limit", [-1, 100_000])
def test_distances_from_points_are_those_of_all_pairs(monkeypatch, limit):
    places, points = np.random.default_rng(3).normal(size=(2, 70, 3))
    monkeypatch.setattr(surface, "MAX_COMPARED_PAIRS", limit)
    expected = np.linalg.norm(points[:, None] - places, axis=2).min(axis=1)
    np.testing.assert_allclose(measure_distances(places, points), expected, rtol=1e-14, atol=0)


def test_weights_give_the_nearest_point():
    mesh = concave()
    points = np.random.default_rng(1).uniform(-1, 3, (100, 3))
    nearest = closest_points(mesh, points)
    chosen = np.arange(100) % 2 == 0
    weights = nearest.barycentric_weights(chosen)
    np.testing.assert_allclose(weights @ mesh.vertices, nearest.position[chosen], atol=1e-12)
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-12)
    assert nearest.barycentric_weights(np.zeros(100, bool)).shape == (0, len(mesh.vertices))


def test_winding_numbers_tell_inside_as_trimesh_does():
    mesh = ball(2, 1.0)
    points = np.random.default_rng(2).uniform(-1.2, 1.2, (500, 3))
    radius = np.linalg.norm(points, axis=1)
    clear = (radius < 0.9) | (radius > 1.01)
    found = winding_numbers(mesh, points) > 0.5
    np.testing.assert_array_equal(found[clear], radius[clear] < 0.95)
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).is_watertight
    np.testing.assert_allclose(winding_numbers(mesh.flip(), np.zeros((1, 3))), -1, atol=1e-12)
