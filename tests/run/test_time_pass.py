"""Rotations of cages without their meshes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cageik_cli import bind
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.run.time_pass import find_rotations
from tests.shapes import ball, box


@pytest.fixture(scope="module")
def binding():
    return bind(ball(levels=2, size=1.0), box(2.0), coordinates="mean-value")


@pytest.fixture(params=[False, True])
def solver(binding, request):
    """Of weights that give the rest pose, and of others, whose offsets turn with the frames."""
    if request.param:
        noise = 0.1 * np.random.default_rng(8).standard_normal(binding.weights.shape)
        noise[binding.rest.vertices[:, 0] > 0] *= 3
        weights = binding.weights + noise - noise.mean(axis=1, keepdims=True)
        binding = replace(binding, weights=weights, has_offsets=True)
    return DualLaplacianSolver(binding, SolveSettings())


def test_cages_that_turn_have_their_turn(solver):
    turns = Rotation.from_rotvec([[0.0, 0, 0], [0.3, 1.9, -0.4], [0, 0, 3.1]]).as_matrix()
    cages = solver.binding.cage.vertices @ turns + [3.0, -2.0, 1.0]
    np.testing.assert_allclose(find_rotations(solver, cages), turns, rtol=0, atol=1e-12)


def test_rotations_of_bent_cages_are_near_those_of_the_solve(solver):
    """Where offsets are left out, they are up to 23 degrees apart."""
    rng = np.random.default_rng(2)
    turn = Rotation.from_rotvec([0.3, 1.9, -0.4]).as_matrix()
    rest = solver.binding.rest.vertices
    frames = np.stack([rest @ np.diag([1.2, 1, 0.8]), rest + 0.1 * rest[:, ::-1] ** 2]) @ turn
    found = solver.solve(frames + 0.01 * rng.standard_normal(frames.shape))
    between = find_rotations(solver, found.cages) @ found.rotations.swapaxes(1, 2)
    assert np.degrees(Rotation.from_matrix(between).magnitude()).max() < 2


def test_without_alignment_nothing_is_turned(binding):
    solver = DualLaplacianSolver(binding, SolveSettings(align=False))
    cages = binding.cage.vertices[None] @ Rotation.from_rotvec([0, 0, 1.0]).as_matrix()
    np.testing.assert_array_equal(find_rotations(solver, cages), [np.eye(3)])
