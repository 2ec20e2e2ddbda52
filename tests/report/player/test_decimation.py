"""Coarser meshes of a mesh's own vertices."""

import numpy as np
import pytest

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.report.player.payload import decimate
from tests.shapes import ball


@pytest.mark.parametrize("largest", [4, 50, 300])
def test_a_ball_keeps_its_shape(largest):
    mesh = ball(levels=4, size=1.0)
    vertices, faces = decimate(mesh, largest)
    assert len(vertices) <= largest < len(mesh.vertices)
    assert (np.diff(vertices) > 0).all()
    assert (np.unique(faces) < len(vertices)).all()
    kept = TriMesh(mesh.vertices[vertices], faces)
    if largest == 300:
        assert kept.is_closed
        assert kept.volume == pytest.approx(mesh.volume, rel=0.1)
        assert len(vertices) > 0.6 * largest


def test_a_mesh_that_is_small_enough_is_kept():
    mesh = ball(levels=1, size=1.0)
    vertices, faces = decimate(mesh, len(mesh.vertices))
    np.testing.assert_array_equal(vertices, np.arange(len(mesh.vertices)))
    np.testing.assert_array_equal(faces, mesh.faces)


def test_no_face_is_drawn_twice_or_without_area():
    _, faces = decimate(ball(levels=4, size=1.0), 100)
    assert (np.diff(np.sort(faces, axis=1), axis=1) > 0).all()
    first = faces.argmin(axis=1)[:, None]
    turned = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    assert len(np.unique(turned, axis=0)) == len(turned)


def test_vertices_without_faces_are_left_out():
    mesh = ball(levels=1, size=1.0)
    loose = TriMesh(np.vstack([[[9.0, 9, 9]], mesh.vertices]), mesh.faces + 1)
    vertices, _ = decimate(loose, len(mesh.vertices))
    np.testing.assert_array_equal(vertices, np.arange(1, len(mesh.vertices) + 1))
