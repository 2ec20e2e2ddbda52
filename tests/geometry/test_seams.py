"""Vertices that never come apart are one; those that part in a frame are not."""

import numpy as np
import pytest

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.seams import Seams
from tests.shapes import ball, box, merged, octahedron

BALL = ball(1)


def split_corners(mesh):
    """A mesh whose triangles share no vertex, and the vertex that each corner was."""
    corners = mesh.faces.ravel()
    return TriMesh(mesh.vertices[corners], np.arange(len(corners)).reshape(-1, 3)), corners


def bend(points, by=0.3):
    return points + by * np.sin(3 * points[:, [1, 2, 0]])


def test_a_mesh_without_copies_has_no_seam_and_reads_no_frame():
    def read():
        raise AssertionError
        yield

    assert Seams.find(BALL, read()) is None


def test_copies_of_corners_are_one_vertex_each():
    split, corners = split_corners(BALL)
    seams = Seams.find(split, [bend(split.vertices)])
    welded = seams.weld()
    assert welded.is_closed
    assert len(welded.vertices) == len(BALL.vertices)
    np.testing.assert_array_equal(welded.vertices[seams.places], split.vertices)
    for vertex in range(len(BALL.vertices)):
        assert len(set(seams.places[corners == vertex])) == 1
    count = len(corners)
    assert seams.note.startswith(f"{count} vertices at {len(BALL.vertices)} places never come apar")
    assert (np.diff(seams.firsts) > 0).all()


def test_copies_that_differ_by_rounding_are_one():
    split, _ = split_corners(BALL)
    noise = np.random.default_rng(1).uniform(-3e-8, 3e-8, split.vertices.shape)
    moved = split.move(split.vertices + noise * BALL.diagonal)
    frame = bend(moved.vertices).astype(np.float32).astype(np.float64)
    assert len(Seams.find(moved, [frame]).firsts) == len(BALL.vertices)


def test_sheets_that_touch_at_rest_and_part_in_one_frame_are_two():
    """Each of four copies at a corner is of one of two sheets, and stays with its own."""
    lower, _ = split_corners(box(1.0))
    upper = lower.move(lower.vertices)
    both = merged(lower, upper)
    n = len(lower.vertices)
    assert len(Seams.find(both, [both.vertices]).firsts) == 8
    opened = both.vertices.copy()
    opened[n:] += [0, 0, 0.01]
    seams = Seams.find(both, [both.vertices, opened, both.vertices])
    assert len(seams.firsts) == 16
    assert not set(seams.places[:n]) & set(seams.places[n:])


def test_one_vertex_that_leaves_its_copies_is_its_own_and_all_apart_are_no_seam():
    split, corners = split_corners(octahedron())
    frame = split.vertices.copy()
    frame[5] += 0.1
    seams = Seams.find(split, [frame])
    assert (seams.places == seams.places[5]).sum() == 1
    assert len(seams.firsts) == 7
    scattered = split.vertices + np.arange(len(corners))[:, None]
    assert Seams.find(split, [frame, scattered]) is None


def test_missing_vertices_say_nothing():
    split, _ = split_corners(octahedron())
    frame = bend(split.vertices)
    frame[::3] = np.nan
    assert len(Seams.find(split, [frame]).firsts) == 6


def test_triangles_between_copies_are_left_out():
    split, corners = split_corners(octahedron())
    first, second = np.flatnonzero(corners == 0)[:2]
    zipped = TriMesh(split.vertices, np.vstack([split.faces, [[first, second, 1]]]))
    welded = Seams.find(zipped, [zipped.vertices]).weld()
    assert len(welded.faces) == len(split.faces)


def test_many_vertices_at_one_point_make_no_pairs():
    """As parts that are hidden by collapsing them: pairs of them would fill memory."""
    points = np.zeros((200_000, 3))
    points[:3] = np.eye(3)
    mesh = TriMesh(points, np.array([[0, 1, 2], [3, 4, 5]]))
    seams = Seams.find(mesh, [points])
    assert len(seams.firsts) == 4
    assert len(seams.weld().faces) == 1


def test_points_that_are_denser_than_the_tolerance_are_apart_unless_equal():
    cloud = np.random.default_rng(4).uniform(-1e-8, 1e-8, (500, 3))
    mesh = TriMesh(np.vstack([np.eye(3), cloud, cloud[:1]]), np.array([[0, 1, 2]]))
    assert len(Seams.find(mesh, []).firsts) == 503


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_weights_of_vertices_add_up(scale):
    split, corners = split_corners(octahedron())
    seams = Seams.find(split, [])
    weights = np.random.default_rng(2).uniform(1, 2, len(corners)) * scale
    found = seams.sum_weights(weights)
    assert found.mean() == pytest.approx(1)
    expected = np.bincount(corners, weights)
    ratios = found[seams.places] / expected[corners]
    np.testing.assert_allclose(ratios, ratios[0], rtol=1e-12)
