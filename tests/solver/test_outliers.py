"""Vertices thrown away from their neighbours, found in the data alone."""

import numpy as np
import pytest

from cageik_cli.solver.outliers import has_thrown_vertices
from tests.shapes import ball

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
def test_thrown_vertices_are_told_from_motion(frames, expected):
    assert has_thrown_vertices(BALL, frames) is expected


def test_a_vertex_that_is_thrown_in_the_rest_pose_is_found():
    frames = throw(0.2)
    assert has_thrown_vertices(BALL.move(frames[-1]), frames[:-1])
