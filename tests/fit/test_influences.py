import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cageik_cli.fit.alternate import (
    Influences,
    minimize_on_simplex,
    project_to_simplex,
    refit_influences,
)
from cageik_cli.fit.problem import (
    Displacements,
    Motion,
    SurfaceLaplacian,
    WeightProblem,
    complement_basis,
)
from cageik_cli.geometry.shape import uniform_laplacian
from tests.fitted import cage_motion, small_binding


def pose(binding, vertex_weights=None, jobs=1):
    surface = SurfaceLaplacian(binding.rest)
    basis = complement_basis(binding.cage)
    return WeightProblem(binding.weights, basis, surface, vertex_weights, 0.1, 1.0, jobs)


@given(arrays(np.float64, (3, 5), elements=st.floats(-10, 10)))
def test_the_projection_is_on_the_simplex_and_nearest(points):
    found = project_to_simplex(points)
    assert found.min() >= 0
    np.testing.assert_allclose(found.sum(axis=1), 1, rtol=0, atol=1e-12)
    # Nearest: no corner of the simplex is further along the offset than the found point.
    offset = points - found
    along = (offset * found).sum(axis=1)
    assert (offset.max(axis=1) <= along + 1e-9).all()


def test_minima_meet_the_conditions_of_optimality():
    generator = np.random.default_rng(0)
    roots = generator.normal(size=(50, 6, 6))
    matrices = roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(6)
    linear = generator.normal(size=(50, 6))
    found = minimize_on_simplex(matrices, linear, np.full((50, 6), 1 / 6), 5000)
    slope = np.einsum("pkl,pl->pk", matrices, found) - linear
    least = slope.min(axis=1, keepdims=True)
    np.testing.assert_allclose(np.where(found > 1e-9, slope - least, 0), 0, rtol=0, atol=1e-6)
    assert (found == 0).any()


def test_rows_have_at_most_k_weights_not_negative_with_sum_one():
    binding = small_binding()
    kept = Influences.from_dense(binding.weights, 3)
    cages = cage_motion(binding, 5)
    motion = Motion(Displacements.of(binding.weights @ cages), cages)
    found = refit_influences(pose(binding, jobs=2), motion, kept, 20)
    dense = found.to_dense(18)
    assert dense.min() >= 0
    assert np.count_nonzero(dense, axis=1).max() <= 3
    np.testing.assert_allclose(dense.sum(axis=1), 1, rtol=0, atol=1e-13)
    before, after = (
        np.linalg.norm((i.to_dense(18) - binding.weights) @ cages) for i in (kept, found)
    )
    assert after < before


def test_more_influences_than_cage_vertices_keep_all():
    binding = small_binding()
    kept = Influences.from_dense(binding.weights, 100)
    np.testing.assert_allclose(kept.to_dense(18), binding.weights, rtol=0, atol=1e-14)


@pytest.mark.parametrize("count", [1, 4])
def test_vertices_of_weight_zero_follow_their_neighbours(count):
    binding = small_binding()
    m = len(binding.rest.vertices)
    kept = Influences.from_dense(binding.weights, count)
    motion = Motion(
        Displacements.of(np.random.default_rng(0).normal(size=(m, 6))), cage_motion(binding, 2)
    )
    found = refit_influences(pose(binding, np.zeros(m)), motion, kept, 50)
    dense = kept.to_dense(18)
    mean = dense - uniform_laplacian(binding.rest) @ dense / 2
    goal = project_to_simplex(np.take_along_axis(mean, kept.places, axis=1))
    np.testing.assert_allclose(found.weights, goal, rtol=0, atol=1e-12)
