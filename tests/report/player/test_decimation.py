"""Coarser meshes of a mesh's own vertices."""

import numpy as np
import pytest

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.report.player.decimation import decimate
from tests.shapes import ball


@pytest.mark.parametrize("largest", [4, 50, 300])
def test_a_ball_keeps_its_shape(largest):
    mesh = ball(levels=4, size=1.0)
    coarse = decimate(mesh, largest)
    assert len(coarse.vertices) <= largest < len(mesh.vertices)
    assert (np.diff(coarse.vertices) > 0).all()
    assert (np.unique(coarse.faces) < len(coarse.vertices)).all()
    kept = TriMesh(mesh.vertices[coarse.vertices], coarse.faces)
    if largest == 300:
        assert kept.is_closed
        assert kept.volume == pytest.approx(mesh.volume, rel=0.1)
        assert len(coarse.vertices) > 0.6 * largest


def test_a_mesh_that_is_small_enough_is_kept():
    mesh = ball(levels=1, size=1.0)
    coarse = decimate(mesh, len(mesh.vertices))
    np.testing.assert_array_equal(coarse.vertices, np.arange(len(mesh.vertices)))
    np.testing.assert_array_equal(coarse.faces, mesh.faces)


def test_no_face_is_drawn_twice_or_without_area():
    coarse = decimate(ball(levels=4, size=1.0), 100)
    assert (np.diff(np.sort(coarse.faces, axis=1), axis=1) > 0).all()
    first = coarse.faces.argmin(axis=1)[:, None]
    turned = np.take_along_axis(coarse.faces, (first + np.arange(3)) % 3, axis=1)
    assert len(np.unique(turned, axis=0)) == len(turned)


def test_vertices_without_faces_are_left_out():
    mesh = ball(levels=1, size=1.0)
    loose = TriMesh(np.vstack([[[9.0, 9, 9]], mesh.vertices]), mesh.faces + 1)
    coarse = decimate(loose, len(mesh.vertices))
    np.testing.assert_array_equal(coarse.vertices, np.arange(1, len(mesh.vertices) + 1))
