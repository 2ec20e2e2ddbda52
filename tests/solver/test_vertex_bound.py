"""The smallest possible error: a truncated SVD of all columns, however they come in."""

import numpy as np
import pytest

from cageik_cli.solver.vertex_bound import (
    MAX_SAMPLED,
    MIN_SAMPLED,
    VertexBoundAccumulator,
    spread_vertices,
)

POINTS = 4


def clip(vertices, frames, seed=1):
    return np.random.default_rng(seed).normal(size=(vertices, 3 * frames)).astype(np.float32)


def accumulate(columns, frames, step=2):
    bound = VertexBoundAccumulator()
    for start in range(0, columns.shape[1], 3 * step):
        bound.update(columns[:, start : start + 3 * step])
    return bound.finish(POINTS, frames)


@pytest.mark.parametrize(("vertices", "frames"), [(30, 5), (30, 10), (30, 40), (7, 40), (3, 9)])
def test_it_is_what_the_truncated_decomposition_leaves(vertices, frames):
    """Fewer columns than vertices, as many, and more."""
    columns = clip(vertices, frames)
    left = np.linalg.svd(columns.astype(float), compute_uv=False)[POINTS:]
    expected = 100 * np.sqrt((left**2).sum() / (vertices * frames))
    for step in (1, 3, 100):
        found = accumulate(columns, frames, step)
        assert found.rms_percent == pytest.approx(expected, rel=1e-9)
        assert (found.points, found.vertices) == (POINTS, vertices)


def test_gaps_do_not_count():
    columns = clip(20, 10)
    with_gaps = np.hstack([columns, np.zeros((20, 6), np.float32)])
    assert accumulate(with_gaps, 10).rms_percent == pytest.approx(
        accumulate(columns, 10).rms_percent, rel=1e-9
    )


def test_a_motion_of_few_points_can_be_exact():
    columns = (clip(50, 1) @ clip(3, 20).astype(np.float32)).astype(np.float32)
    assert accumulate(columns, 20).rms_percent < 1e-3


def test_nothing_has_no_bound():
    assert VertexBoundAccumulator().finish(POINTS, 3) is None
    empty = VertexBoundAccumulator()
    empty.update(np.empty((0, 6), np.float32))
    assert empty.finish(POINTS, 2) is None
    assert accumulate(np.zeros((5, 3), np.float32), 0) is None


@pytest.mark.parametrize(
    ("count", "points", "expected"),
    [(100, 60, 100), (10_000, 8, MIN_SAMPLED), (10_000, 100, 800), (10_000, 500, MAX_SAMPLED)],
)
def test_vertices_are_spread_over_the_numbers(count, points, expected):
    numbers = 3 * np.arange(count)
    found = spread_vertices(numbers, points)
    assert len(np.unique(found)) == expected
    assert np.isin(found, numbers).all()
    assert (found[0], found[-1]) == (0, numbers[-1])
    assert np.diff(found).max() <= 3 * (count // expected + 1)
