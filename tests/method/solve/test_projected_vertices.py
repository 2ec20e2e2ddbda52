"""Vertices outside the cage, projected onto it: they are fitted by how they move."""

import numpy as np
import pytest

from cageik_cli.cages.bind import bind
from cageik_cli.geometry.shape import uniform_laplacian
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.weights.settings import BindSettings
from tests.shapes import ball, box, changed, finer, rotation
from tests.texts import texts

CAGE = finer(box(0.8), 1)
PROJECT = BindSettings(outside="project")
ALPHA = 1e-3


@pytest.fixture(scope="module")
def binding():
    """A ball of which the vertices on one side are outside."""
    inside = ball(2, 0.75).vertices
    return bind(changed(ball(2), vertices=inside + np.array([0.12, 0, 0])), CAGE, PROJECT)


def test_some_vertices_are_projected_and_the_note_tells_the_error_of_it(binding):
    assert 0.02 < binding.projected / 66 < 0.3
    away = binding.weights @ binding.cage.vertices - binding.rest.vertices
    expected = 100 * np.sqrt((away**2).sum(axis=1).mean()) / binding.rest.diagonal
    (note,) = [one for one in texts(binding.notes) if "outside the cage" in one]
    assert f"that alone is an error of {expected:.2g} % of the diagonal (rms)" in note


@pytest.mark.parametrize("align", [True, False])
def test_the_rest_pose_gives_the_rest_cage(binding, align):
    """Moved rigidly, it gives the cage that is moved rigidly."""
    solver = DualLaplacianSolver(binding, SolveSettings(ALPHA, 1.0, align))
    turn = rotation(3) if align else np.eye(3)
    cages = solver.solve((binding.rest.vertices @ turn)[None]).cages
    np.testing.assert_allclose(cages[0], CAGE.vertices @ turn, atol=1e-12)


def test_the_change_from_the_rest_pose_is_the_least_squares_solution(binding):
    """Oracle: numpy's lstsq on displacements; on positions it is another cage."""
    rest, weights = binding.rest.vertices, binding.weights
    m, n = weights.shape
    frame = rest + 0.1 * np.sin(5 * rest[:, [1, 2, 0]])
    laplacian = np.sqrt(ALPHA / n) * uniform_laplacian(CAGE)
    rows = np.vstack([laplacian, weights / np.sqrt(m)])

    def solve(target):
        right = np.vstack([np.zeros((n, 3)), target / np.sqrt(m)])
        return CAGE.vertices + np.linalg.lstsq(rows, right, rcond=None)[0]

    solver = DualLaplacianSolver(binding, SolveSettings(ALPHA, 1.0, align=False))
    found = solver.solve(frame[None]).cages[0]
    np.testing.assert_allclose(found, solve(frame - rest), atol=1e-10)
    other = solve(frame - weights @ CAGE.vertices)
    assert np.abs(other - found).max() > 1e-3
    errors = [np.linalg.norm(weights @ cage - frame) for cage in (found, other)]
    assert errors[1] < errors[0] < 1.3 * errors[1]
