import numpy as np
import pytest

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.solver.fitting.affine import complement_basis, restore_affine
from cageik_cli.util.errors import CageError
from tests.fitted import small_binding
from tests.shapes import TETRAHEDRON, ball


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
