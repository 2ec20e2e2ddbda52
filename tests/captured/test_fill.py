"""Missing parts filled over time, and occluded vertices placed by the surface around them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cageik_cli import bind
from cageik_cli.captured.fill import BRIDGE_LENGTH, FrameTerms, RigidFiller, TimeFiller
from cageik_cli.geometry.mesh import TriMesh
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


TURN = Rotation.from_rotvec([0.3, 1.9, -0.4]).as_matrix()


@pytest.fixture
def rest():
    return ball(levels=3, size=1.0)


def hide(rest, share=0.3):
    height = rest.vertices[:, 1]
    return height > np.quantile(height, 1 - share)


def test_what_is_hidden_of_a_body_that_moves_rigidly_moves_with_it(rest):
    hidden, moved = hide(rest), rest.vertices @ TURN + [3.0, -1.0, 2.0]
    guess = moved.copy()
    guess[hidden] += 0.1 * np.random.default_rng(3).standard_normal((hidden.sum(), 3))
    found = RigidFiller(rest).fill(guess, hidden)
    np.testing.assert_array_equal(found[~hidden], moved[~hidden])
    assert np.abs(found - moved).max() < 0.1 * np.abs(guess - moved).max()


def test_the_true_place_is_kept_in_any_order_of_masks(rest):
    filler, moved = RigidFiller(rest), rest.vertices @ TURN
    for share in (0.3, 0.0, 0.1, 0.3):
        hidden = hide(rest, share) if share else np.zeros(len(rest.vertices), bool)
        np.testing.assert_allclose(filler.fill(moved, hidden), moved, rtol=0, atol=1e-6)


def test_a_part_of_which_nothing_is_seen_stays_and_keeps_its_shape(rest):
    count = len(rest.vertices)
    two = TriMesh(
        np.concatenate([rest.vertices, rest.vertices + 5]),
        np.concatenate([rest.faces, rest.faces + count]),
    )
    hidden = np.arange(2 * count) >= count
    found = RigidFiller(two).fill(two.vertices, hidden)
    np.testing.assert_allclose(found, two.vertices, rtol=0, atol=1e-5)


def test_values_are_continued_as_smoothly_as_they_can_be(rest):
    """Against a dense least squares over the hidden vertices."""
    ends, count = rest.edges.ends, len(rest.vertices)
    values, hidden = np.cos(rest.vertices @ TURN), hide(rest)
    laplacian = np.zeros((count, count))
    for first, second in (ends.T, ends[:, ::-1].T):
        np.add.at(laplacian, (first, first), 1.0)
        np.add.at(laplacian, (first, second), -1.0)
    laplacian /= np.sqrt(np.diag(laplacian))[:, None]
    known = laplacian[:, ~hidden] @ values[~hidden]
    expected = np.linalg.lstsq(laplacian[:, hidden], -known, rcond=None)[0]
    found = RigidFiller(rest).extend(np.where(hidden[:, None], 7.0, values), hidden)
    np.testing.assert_allclose(found[hidden], expected, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(found[~hidden], values[~hidden])


def test_equal_values_are_continued_in_any_order_of_masks(rest):
    filler, values = RigidFiller(rest), np.tile([1.0, -2.0, 3.0], (len(rest.vertices), 1))
    for share in (0.3, 0.0, 0.1, 0.3):
        hidden = hide(rest, share) if share else np.zeros(len(rest.vertices), bool)
        spoilt = np.where(hidden[:, None], 0.0, values)
        np.testing.assert_allclose(filler.extend(spoilt, hidden), values, rtol=0, atol=1e-5)
