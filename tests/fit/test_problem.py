import numpy as np
import pytest

from cageik_cli.fit.problem import (
    COMPRESSION_TOL,
    Displacements,
    Motion,
    SurfaceLaplacian,
    WeightProblem,
    complement_basis,
    restore_affine,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import uniform_laplacian
from cageik_cli.util.errors import CageError
from tests.fitted import cage_motion, small_binding, true_weights
from tests.shapes import TETRAHEDRON, ball

BINDING = small_binding()
SURFACE = SurfaceLaplacian(BINDING.rest)
COMPLEMENT = complement_basis(BINDING.cage)


def pose(regularization=0.1, smoothness=1.0, weights=None, negligible=0.0, jobs=1):
    """A problem that is solved to rounding."""
    return WeightProblem(
        BINDING.weights, COMPLEMENT, SURFACE, weights, regularization, smoothness,
        jobs, tolerance=1e-14, max_steps=10_000, negligible=negligible,
    )  # fmt: skip


def fitted(problem, motion):
    return problem.add_change(problem.fit(motion))


def dense_minimum(problem, target, cages, data):
    """The same minimum by the conditions of optimality, with multipliers, as one dense system."""
    m, n = problem.rest_weights.shape
    scale = np.square(cages).sum() / n
    laplacian = uniform_laplacian(BINDING.rest)
    surface = problem.smoothness * laplacian.T @ laplacian + problem.regularization * np.eye(m)
    hessian = np.kron(np.diag(data), cages @ cages.T) + scale * np.kron(surface, np.eye(n))
    right = (data[:, None] * (target - problem.rest_weights @ cages)) @ cages.T
    affine = np.column_stack([np.ones(n), BINDING.cage.vertices])
    constraints = np.kron(np.eye(m), affine.T)
    zeros = np.zeros((len(constraints),) * 2)
    system = np.block([[hessian, constraints.T], [constraints, zeros]])
    found = np.linalg.solve(system, np.concatenate([right.ravel(), np.zeros(len(zeros))]))
    return problem.rest_weights + found[: m * n].reshape(m, n)


@pytest.mark.parametrize("is_weighted", [False, True])
@pytest.mark.parametrize(("regularization", "smoothness"), [(0.1, 1.0), (1e-3, 10.0), (0.3, 0.0)])
def test_fitted_weights_are_those_of_a_dense_constrained_solve(
    regularization, smoothness, is_weighted
):
    """Oracle: numpy's general solve of the conditions of optimality."""
    m = len(BINDING.rest.vertices)
    data = np.ones(m)
    if is_weighted:
        data = np.random.default_rng(1).uniform(0, 2, m)
        data[:5] = 0
    weights = data if is_weighted else None
    problem = pose(regularization, smoothness, weights)
    cages = cage_motion(BINDING, 4)
    target = np.random.default_rng(2).normal(size=(m, 12))
    found = fitted(problem, Motion(Displacements.of(target), cages))
    expected = dense_minimum(problem, target, cages, data)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)
    assert np.abs(expected - BINDING.weights).max() > 1e-2


def test_known_weights_come_back_as_the_regularization_vanishes():
    expected = true_weights(BINDING)
    cages = cage_motion(BINDING, 20)
    motion = Motion(Displacements.of(expected @ cages), cages)
    errors = []
    for strength in (1e-2, 1e-4, 1e-6, 1e-8):
        problem = pose(strength, strength)
        errors.append(np.abs(fitted(problem, motion) - expected).max())
    assert np.all(np.diff(errors) < 0)
    assert errors[-1] < 1e-6


def test_rows_stay_affine_exact():
    cages = cage_motion(BINDING, 6)
    target = np.random.default_rng(2).normal(size=(len(BINDING.rest.vertices), 18))
    problem = pose(1e-6)
    found = fitted(problem, Motion(Displacements.of(target), cages))
    np.testing.assert_allclose(found.sum(axis=1), 1, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        found @ BINDING.cage.vertices, BINDING.rest.vertices, rtol=0, atol=1e-12
    )


def test_a_cage_that_does_not_move_leaves_the_weights():
    target = Displacements.of(np.ones((len(BINDING.rest.vertices), 6)))
    problem = pose()
    found = fitted(problem, Motion(target, np.zeros((len(BINDING.cage.vertices), 6))))
    np.testing.assert_array_equal(found, BINDING.weights)


def test_directions_in_which_the_cage_hardly_moves_are_left_out():
    cages = cage_motion(BINDING, 1) @ np.ones((3, 24))
    cages += 1e-6 * cage_motion(BINDING, 8)
    motion = Motion(Displacements.of(true_weights(BINDING) @ cages), cages)
    exact = pose().fit(motion)
    found = pose(negligible=1e-3).fit(motion)
    assert exact.columns.shape[1] == COMPLEMENT.shape[1]
    assert found.columns.shape[1] == found.basis.shape[1] == 1
    moved, expected = (c.add_to(BINDING.weights) @ cages for c in (found, exact))
    assert np.linalg.norm(moved - expected) < 1e-3 * np.linalg.norm(expected)


def test_threads_do_not_change_a_bit():
    cages = cage_motion(BINDING, 4)
    target = Displacements.of(true_weights(BINDING) @ cages)
    one, three = (fitted(pose(jobs=jobs), Motion(target, cages)) for jobs in (1, 3))
    np.testing.assert_array_equal(one, three)


def test_the_basis_is_orthonormal_and_orthogonal_to_affine_functions():
    cage = ball(1)
    moved = TriMesh(1e3 * cage.vertices + 1e5, cage.faces)
    basis = complement_basis(moved)
    assert basis.shape == (18, 14)
    np.testing.assert_allclose(basis.T @ basis, np.eye(14), rtol=0, atol=1e-13)
    np.testing.assert_allclose(basis.sum(axis=0), 0, rtol=0, atol=1e-13)
    np.testing.assert_allclose(cage.vertices.T @ basis, 0, rtol=0, atol=1e-9)


def test_a_tetrahedron_leaves_no_freedom():
    assert complement_basis(TETRAHEDRON).shape == (4, 0)


def test_weights_that_are_not_exact_become_so():
    binding = small_binding()
    noise = 1e-3 * np.random.default_rng(0).normal(size=binding.weights.shape)
    found = restore_affine(binding.weights + noise, binding.rest, binding.cage)
    np.testing.assert_allclose(found.sum(axis=1), 1, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        found @ binding.cage.vertices, binding.rest.vertices, rtol=0, atol=1e-12
    )
    assert np.abs(found - binding.weights).max() < 1e-2


def test_exact_weights_are_not_copied():
    binding = small_binding()
    assert restore_affine(binding.weights, binding.rest, binding.cage) is binding.weights


def test_a_flat_cage_is_refused():
    flat = TriMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]])
    with pytest.raises(CageError, match="4 vertices"):
        complement_basis(flat)


RANDOM = np.random.default_rng(3)
SMOOTH = RANDOM.normal(size=(200, 9)) @ RANDOM.normal(size=(9, 120))
"""Displacements of 40 frames that have nine directions."""


def whole(target):
    return np.hstack(list(target.blocks()))


@pytest.mark.parametrize("row_weights", [None, RANDOM.uniform(size=200)])
def test_the_product_with_the_transpose_is_summed_over_blocks_of_rows(row_weights):
    target = Displacements.of(SMOOTH).take(np.arange(3, 30))
    data = whole(target)
    expected = data.T @ (data if row_weights is None else row_weights[:, None] * data)
    found = target.multiply_by_transpose(row_weights, max_entries=1000)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_compressed_displacements_have_the_same_products_of_rows():
    target = Displacements.of(SMOOTH)
    compressed = target.compress()
    assert len(compressed) == 3
    assert compressed.weight == target.weight
    data, short = whole(target), whole(compressed)
    np.testing.assert_allclose(short @ short.T, data @ data.T, rtol=0, atol=1e-10)


def test_a_compression_leaves_out_what_is_below_its_tolerance():
    noise = RANDOM.normal(size=SMOOTH.shape)
    noise *= COMPRESSION_TOL * np.linalg.norm(SMOOTH) / np.linalg.norm(noise)
    assert len(Displacements.of(SMOOTH + 0.5 * noise).compress()) == 3
    assert len(Displacements.of(SMOOTH + 5 * noise).compress()) > 3


def test_vertices_without_weight_do_not_count_in_a_compression():
    wild = SMOOTH.copy()
    wild[:20] = 1e6 * RANDOM.normal(size=(20, SMOOTH.shape[1]))
    weights = np.ones(len(wild))
    weights[:20] = 0
    data, short = SMOOTH[20:], whole(Displacements.of(wild).compress(weights))[20:]
    np.testing.assert_allclose(short @ short.T, data @ data.T, rtol=0, atol=1e-9)


@pytest.mark.parametrize("columns", [RANDOM.normal(size=(200, 30)), np.zeros((200, 30))])
def test_displacements_that_cannot_be_compressed_are_returned(columns):
    target = Displacements.of(columns)
    assert target.compress() is target


def test_single_precision_is_kept():
    assert Displacements.of(SMOOTH.astype(np.float32)).compress().parts[0].dtype == np.float32
