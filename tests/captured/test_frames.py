"""Tolerances: what a cage cannot follow is allowed, what stands out of it is not."""

import numpy as np
import pytest

from cageik_cli import bind
from cageik_cli.captured.frames import measure_tolerances, take_medians, take_ring_medians
from cageik_cli.captured.robust import RobustSolver
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from tests.shapes import ball, box

RNG = np.random.default_rng(8)


@pytest.fixture(scope="module")
def robust():
    binding = bind(ball(levels=2, size=1.0), box(2.0), coordinates="mean-value")
    return RobustSolver(DualLaplacianSolver(binding, SolveSettings()))


def captured(frames, weights=None):
    return [
        (frame[None], None if weights is None else weights[k][None])
        for k, frame in enumerate(frames)
    ]


def noisy(robust, count, size=0.01):
    rest = robust.solver.binding.rest.vertices
    noise = np.random.default_rng(4).standard_normal((count, *rest.shape))
    return rest + size * noise


def test_tolerances_are_multiples_of_the_noise(robust):
    found = measure_tolerances(robust, captured(noisy(robust, 9)))
    middle = 0.01 * 1.538  # of the length of a Gaussian vector in space
    np.testing.assert_allclose(np.median(found), 2 * 5.0 * middle, rtol=0.1)
    assert found.max() < 1.5 * np.median(found)


def test_a_vertex_that_is_always_off_is_not_tolerated(robust):
    frames = noisy(robust, 9)
    frames[:, 5] += 0.6
    clean = measure_tolerances(robust, captured(noisy(robust, 9)))
    first = measure_tolerances(robust, captured(frames))
    found = measure_tolerances(RobustSolver(robust.solver, first), captured(frames))
    assert found[5] < 1.3 * clean[5] < 0.3


def test_the_rest_pose_and_missing_vertices_do_not_lower_tolerances(robust):
    frames = noisy(robust, 3)
    frames[0] = robust.solver.binding.rest.vertices
    weights = np.ones(frames.shape[:2])
    weights[1:, :10] = 0
    found = measure_tolerances(robust, captured(frames, weights))
    clean = measure_tolerances(robust, captured(frames[1:]))
    assert np.median(found) > 0.9 * np.median(clean)
    assert np.isfinite(found).all()


def test_exact_frames_have_the_smallest_tolerance(robust):
    rest = robust.solver.binding.rest
    found = measure_tolerances(robust, captured(rest.vertices[None]))
    np.testing.assert_allclose(found, 1e-5 * rest.diagonal)


def test_medians_leave_out_nan():
    rows = np.array([[1.0, np.nan, np.nan], [3.0, 5.0, np.nan], [8.0, 7.0, np.nan]])
    np.testing.assert_array_equal(take_medians(rows), [3.0, 6.0, np.nan])


def test_ring_medians_are_of_a_vertex_and_its_neighbours(robust):
    mesh = robust.solver.binding.rest
    values = RNG.random(len(mesh.vertices))
    values[3] = np.nan
    found = take_ring_medians(mesh, values)
    for vertex in (0, 3, 20):
        ring = {vertex, *mesh.edges.ends[(mesh.edges.ends == vertex).any(axis=1)].ravel()}
        ordered = np.sort([values[k] for k in ring if np.isfinite(values[k])])
        assert found[vertex] == ordered[(len(ordered) - 1) // 2]
