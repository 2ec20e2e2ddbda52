"""Missing parts filled over time, against one dense solve of all frames."""

import numpy as np
import pytest

from cageik_cli import bind
from cageik_cli.captured.fill import BRIDGE_LENGTH, FrameTerms, TimeFiller
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from tests.shapes import ball, box

RNG = np.random.default_rng(11)
FRAMES = 30


@pytest.fixture(scope="module")
def solver():
    binding = bind(ball(levels=2, size=1.0), box(2.0), coordinates="mean-value")
    return DualLaplacianSolver(binding, SolveSettings())


def dense_solution(matrices, right, gamma):
    """All frames as one system."""
    count, n = right.shape[:2]
    bends = np.kron(np.diff(np.eye(count), 2, axis=0), np.eye(n))
    whole = gamma * bends.T @ bends
    for t, matrix in enumerate(matrices):
        whole[t * n : t * n + n, t * n : t * n + n] += matrix
    return np.linalg.solve(whole, right.reshape(count * n, 3)).reshape(right.shape)


def test_missing_parts_are_filled_by_the_minimum_over_all_frames(solver):
    filler = TimeFiller(solver, tolerance=1e-9)
    time = np.linspace(0, 2 * np.pi, FRAMES)[:, None, None]
    clean = solver.rest_cage * (1 + 0.2 * np.sin(time)) + [1.0, 0.0, 0.0] * time
    cages = clean + 1e-3 * RNG.standard_normal(clean.shape)
    known = np.ones(FRAMES, bool)
    known[9] = False
    rows = np.arange(40)
    lost = {t: solver.weigh_data(np.ones(40), rows) for t in (3, 12, 13)}
    found = filler.fill(FrameTerms(cages, known, lost))
    np.testing.assert_array_equal(found[20], cages[20])
    np.testing.assert_array_equal(found[9], cages[9])
    matrices = [solver.normal * is_known for is_known in known]
    right = known[:, None, None] * (solver.normal @ cages)
    for t, matrix in lost.items():
        matrices[t] = solver.normal - matrix
        right[t] -= matrix @ cages[t]
    expected = dense_solution(matrices, right, filler.convert_length(BRIDGE_LENGTH))
    for t, matrix in lost.items():
        expected[t] = np.linalg.solve(solver.normal, right[t] + matrix @ expected[t])
    np.testing.assert_allclose(found[[3, 12, 13]], expected[[3, 12, 13]], rtol=0, atol=1e-7)
