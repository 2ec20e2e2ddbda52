import numpy as np
import pytest
import trimesh

from cageik_cli.geometry import surface
from cageik_cli.geometry.mesh import TriMesh
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


@pytest.mark.parametrize("mesh", [box(), concave(), ball(2, 1.0)], ids=["box", "concave", "ball"])
def test_looking_at_every_face_finds_what_the_tree_finds(mesh, monkeypatch):
    points = np.random.default_rng(3).uniform(-2, 3, (150, 3))
    points = np.concatenate([points, mesh.vertices, mesh.vertices[mesh.faces].mean(axis=1)])
    few = closest_points(mesh, points)
    near = measure_distances(mesh.vertices, points)
    monkeypatch.setattr(surface, "MAX_SEARCHED_PAIRS", -1)
    many = closest_points(mesh, points)
    np.testing.assert_allclose(few.distance, many.distance, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(few.position, many.position, rtol=1e-12, atol=1e-14)
    on_face = few.barycentric_weights(np.ones(len(points), bool)) @ mesh.vertices
    np.testing.assert_allclose(on_face, many.position, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(near, measure_distances(mesh.vertices, points), rtol=1e-14, atol=0)


def test_faces_without_area_are_their_sides():
    needle = TriMesh([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [5, 5, 5]], [[0, 1, 2], [3, 3, 3]])
    nearest = closest_points(needle, np.array([[1.5, 1.0, 0], [5.0, 5, 6]]))
    np.testing.assert_allclose(nearest.distance, [1, 1], rtol=1e-15)
    np.testing.assert_allclose(nearest.position, [[1.5, 0, 0], [5, 5, 5]], rtol=1e-15)


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
