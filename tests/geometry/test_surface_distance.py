"""Distances over surfaces of known lengths, and the links between components."""

import numpy as np
import pytest

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.points import PointCloud
from cageik_cli.geometry.surface_distance import (
    MAX_SEARCHED_GROUP,
    SurfaceDistances,
    link_components,
)
from tests.shapes import ball, merged, moved

VERTEX = np.array([1.0, 0, 0])


def strip(count, shift=0.0):
    """A band of squares along x, of unit edges, of 2 count + 2 vertices."""
    x = np.arange(count + 1.0)
    vertices = np.concatenate([np.stack([x, 0 * x + k + shift, 0 * x], axis=1) for k in (0, 1)])
    low = np.arange(count)
    high = low + count + 1
    faces = np.concatenate(
        [np.stack([low, low + 1, high], axis=1), np.stack([low + 1, high + 1, high], axis=1)]
    )
    return TriMesh(vertices, faces)


def test_distances_are_along_edges():
    mesh = strip(6)
    found = SurfaceDistances(mesh).measure(np.array([0, 0, 0]), VERTEX)
    np.testing.assert_allclose(found[:7], np.arange(7), rtol=0, atol=1e-12)
    assert found[7] == 1


def test_a_point_in_a_face_is_as_far_as_its_corners_and_the_way_to_them():
    mesh = strip(6)
    corners, shares = mesh.faces[0], np.array([0.25, 0.75, 0.0])
    found = SurfaceDistances(mesh).measure(corners, shares)
    np.testing.assert_allclose(found[:4], [0.75, 0.25, 1.25, 2.25], rtol=0, atol=1e-12)


def test_distances_go_around_a_gap():
    """Two fingers that nearly touch are far from each other over the surface."""
    mesh = ball(levels=3)
    found = SurfaceDistances(mesh).measure(np.array([0, 0, 0]), VERTEX)
    straight = np.linalg.norm(mesh.vertices - mesh.vertices[0], axis=1)
    opposite = straight.argmax()
    size = np.linalg.norm(mesh.vertices[0])
    assert 0.99 * np.pi * size <= found[opposite] <= 1.1 * np.pi * size
    assert (found >= straight - 1e-12).all()


@pytest.mark.parametrize("count", [3, MAX_SEARCHED_GROUP])
def test_components_are_linked_where_they_are_near(count):
    """Two bands side by side, by each vertex if they are close, else at the nearest place."""
    mesh = merged(strip(count), strip(count, shift=1.5))
    near = link_components(mesh.vertices, mesh.edges.ends, close=0.6)
    assert len(near) == count + 1
    lengths = np.linalg.norm(np.diff(mesh.vertices[near], axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(lengths, 0.5, rtol=0, atol=1e-12)
    assert len(link_components(mesh.vertices, mesh.edges.ends, close=0.0)) >= 1


def test_all_components_become_one():
    """A pair that is near to each other, and far from the rest, is linked to the rest, too."""
    body = ball(levels=2)
    pair = merged(moved(ball(levels=1, size=0.05), shift=(3, 0, 0)),
                  moved(ball(levels=1, size=0.05), shift=(3.11, 0, 0)))  # fmt: skip
    mesh = merged(body, pair)
    found = SurfaceDistances(mesh).measure(np.array([0, 0, 0]), VERTEX)
    assert np.isfinite(found).all()
    assert (found >= np.linalg.norm(mesh.vertices - mesh.vertices[0], axis=1) - 1e-9).all()


def test_a_seam_of_doubled_vertices_is_no_gap():
    first, second = strip(3), moved(strip(3), shift=(3, 0, 0))
    mesh = merged(first, second)
    found = SurfaceDistances(mesh).measure(np.array([0, 0, 0]), VERTEX)
    assert found[len(first.vertices) + 3] == pytest.approx(6)


def test_points_have_straight_distances():
    points = np.random.default_rng(0).normal(size=(20, 3))
    cloud = PointCloud.from_points(points)
    found = SurfaceDistances(cloud).measure(np.array([4, 4, 4]), VERTEX)
    np.testing.assert_allclose(found, np.linalg.norm(points - points[4], axis=1))
