"""Outlier vertices, far from their neighbours, found in the data alone."""

import numpy as np
import pytest

from cageik_cli.captured.robust import find_torn_vertices, has_outlier_vertices
from tests.shapes import ball, merged

BALL = ball(3, 1.0)


def throw(share, count=10):
    """Return frames in which a vertex is off by a share of the diagonal, in the last one."""
    frames = np.repeat(BALL.vertices[None], count, axis=0)
    frames[-1, 7] *= 1 + share * BALL.diagonal
    return frames


@pytest.mark.parametrize(
    ("frames", "expected"),
    [
        (throw(0.15), True),
        (throw(0.1), True),
        (throw(0.045), False),
        (throw(0.0) * [1, 1, 3], False),
        (throw(0.0)[:0], False),
    ],
    ids=["thrown", "thrown less", "pulled", "stretched", "no frame"],
)
def test_outlier_vertices_are_distinguished_from_motion(frames, expected):
    assert has_outlier_vertices(BALL, frames) is expected


def test_an_outlier_vertex_of_the_rest_pose_is_found():
    frames = throw(0.2)
    assert has_outlier_vertices(BALL.move(frames[-1]), frames[:-1])


def find_torn(residuals, mesh=BALL, is_data=None):
    is_data = np.ones(len(residuals), bool) if is_data is None else is_data
    return np.flatnonzero(
        find_torn_vertices(mesh, residuals, np.full(len(residuals), 0.1), is_data)
    )


def make_bump(mesh=BALL):
    """Return residuals that grow to four limits at the first vertex, and nowhere jump by one."""
    ways = np.linalg.norm(mesh.vertices - mesh.vertices[0], axis=1)
    return np.outer(np.maximum(0.4 - 0.3 * ways, 0), [0, 0, 1])


def find_ring(vertex, mesh=BALL):
    ends = mesh.edges.ends
    return np.unique(ends[(ends == vertex).any(axis=1)])


def test_residuals_that_grow_from_vertex_to_vertex_are_not_torn():
    assert not len(find_torn(make_bump()))


def test_outlier_vertices_and_pieces_are_torn():
    residuals = make_bump()
    piece = find_ring(200)
    residuals[piece] += [0.2, 0, 0]
    residuals[0] += [0.3, 0, 0]
    np.testing.assert_array_equal(find_torn(residuals), [0, *piece])


def test_a_component_that_is_off_as_a_whole_is_not_torn():
    both = merged(BALL, BALL)
    residuals = np.zeros((2 * len(BALL.vertices), 3))
    residuals[len(BALL.vertices) :] = [0, 0.5, 0]
    assert not len(find_torn(residuals, both))
    residuals[5] = [0, 0.5, 0]
    np.testing.assert_array_equal(find_torn(residuals, both), [5])


def test_the_surface_ends_at_what_is_missing():
    ring, residuals = find_ring(40), np.zeros((len(BALL.vertices), 3))
    is_data = np.ones(len(residuals), bool)
    is_data[ring] = False
    is_data[40] = True
    np.testing.assert_array_equal(find_torn(residuals, is_data=is_data), [40])
