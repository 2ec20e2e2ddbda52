"""Normals of vertices, of corners and of what shares one."""

import numpy as np
import pytest

from cageik_cli.geometry.attributes import NONE, SurfaceAttributes
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import (
    FALLBACK_NORMAL,
    complete_fans,
    compute_corner_normals,
    compute_fan_normals,
    compute_vertex_normals,
)
from tests.shapes import ball, merged, rotation


def test_normals_of_a_ball_point_outward():
    mesh = ball()
    directions = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    normals = compute_vertex_normals(mesh.polygons, mesh.vertices)
    np.testing.assert_allclose(normals, directions, rtol=0, atol=0.1)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-14)


def test_normals_are_weighted_by_area():
    """A corner of a box whose sides are 1, 2 and 3, of right triangles of the corner's edges."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3.0]])
    faces = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3]])
    expected = -np.array([6, 3, 2]) / 7
    np.testing.assert_allclose(
        compute_vertex_normals(TriMesh(points, faces).polygons, points)[0], expected, rtol=1e-14
    )


@pytest.mark.parametrize("size", [1.0, 1e-90])
def test_a_vertex_whose_faces_cancel_has_no_normal(size):
    """A ball in both windings, beside one in one winding, and a vertex without a face."""
    one, other = ball(), ball()
    both = TriMesh(one.vertices, np.vstack([one.faces, one.faces[:, ::-1]]))
    mesh = merged(both, other)
    points = size * np.vstack([mesh.vertices @ rotation(3), [[9, 9, 9]]])
    normals = compute_vertex_normals(TriMesh(points, mesh.faces).polygons, points)
    count = len(one.vertices)
    np.testing.assert_array_equal(normals[[*range(count), -1]], 0)
    np.testing.assert_allclose(np.linalg.norm(normals[count:-1], axis=1), 1, rtol=1e-14)


def test_a_fan_without_an_area_has_some_normal():
    attributes = SurfaceAttributes(np.array([3]), np.array([0, 1, 2]), normal_fans=np.arange(3))
    normals = compute_fan_normals(attributes, np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]]))
    np.testing.assert_array_equal(normals, [FALLBACK_NORMAL] * 3)


def test_a_corner_without_a_normal_has_that_of_its_face():
    """A square and a triangle that turns up from it; one corner of the square has no normal."""
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0, 3.0]])
    fans = np.array([0, 1, 2, NONE, NONE, NONE, NONE])
    corners = np.array([0, 1, 2, 3, 1, 0, 4])
    attributes = SurfaceAttributes(np.array([4, 3]), corners, normal_fans=fans)
    expected = [[0, 0, 1]] * 4 + [[0, -1, 0]] * 3
    expected = np.array(expected) * np.array([1, 1, 1, 1, -1, -1, -1])[:, None]
    np.testing.assert_allclose(compute_corner_normals(attributes, points), expected, atol=1e-15)
    complete = complete_fans(attributes).normal_fans
    assert len(set(complete.tolist())) == 7
