"""Cages over time, against one dense solve of all frames; windows, gaps and hits."""

import numpy as np
import pytest

from cageik_cli import bind
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.solver.settings import SolveSettings
from cageik_cli.solver.smooth import MIN_WINDOW, STRENGTHS, FrameTerms, TimeSmoother
from tests.shapes import ball, box

RNG = np.random.default_rng(11)
FRAMES = 30


@pytest.fixture(scope="module")
def solver():
    binding = bind(ball(levels=2, size=1.0), box(2.0), coordinates="mean-value")
    return DualLaplacianSolver(binding, SolveSettings())


@pytest.fixture
def smoother(solver):
    return TimeSmoother(solver)


def make_cages(solver, noise=0.02, count=FRAMES):
    time = np.linspace(0, 2 * np.pi, count)[:, None, None]
    clean = solver.rest_cage * (1 + 0.2 * np.sin(time)) + [1.0, 0.0, 0.0] * time
    return clean, clean + noise * RNG.standard_normal(clean.shape)


def dense_solution(matrices, right, gammas):
    """All frames as one system."""
    count, n = right.shape[:2]
    bends = np.kron(np.diff(np.eye(count), 2, axis=0), np.eye(n))
    whole = bends.T @ (np.repeat(gammas, n)[:, None] * bends)
    for t, matrix in enumerate(matrices):
        whole[t * n : t * n + n, t * n : t * n + n] += matrix
    return np.linalg.solve(whole, right.reshape(count * n, 3)).reshape(right.shape)


@pytest.mark.parametrize("period", [0.3, 3.0])
def test_smoothing_is_the_minimum_over_all_frames(solver, period):
    smoother = TimeSmoother(solver, hit_ratio=1e9)
    _, cages = make_cages(solver)
    known = np.ones(FRAMES, bool)
    known[[4, 5, 17]] = False
    gamma = smoother.convert_length(period)
    matrices = [solver.normal * is_known for is_known in known]
    expected = dense_solution(
        matrices, known[:, None, None] * (solver.normal @ cages), np.full(FRAMES - 2, gamma)
    )
    found = smoother.smooth(cages, known, gamma)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


def test_missing_parts_are_filled_by_the_minimum_over_all_frames(solver):
    smoother = TimeSmoother(solver, fill_frames=0.4, fill_tolerance=1e-9)
    clean, cages = make_cages(solver, noise=1e-3)
    known = np.ones(FRAMES, bool)
    known[9] = False
    rows = np.arange(40)
    lost = {t: solver.weigh_data(np.ones(40), rows) for t in (3, 12, 13)}
    found = smoother.fill(FrameTerms(cages, known, lost), noise=1e-6)
    np.testing.assert_array_equal(found[20], cages[20])
    assert np.abs(found[9] - clean[9]).max() < 0.02
    matrices = [solver.normal * is_known for is_known in known]
    right = known[:, None, None] * (solver.normal @ cages)
    for t, matrix in lost.items():
        matrices[t] = solver.normal - matrix
        right[t] -= matrix @ cages[t]
    gammas = np.full(FRAMES - 2, smoother.convert_length(0.4))
    expected = dense_solution(matrices, right, gammas)
    for t, matrix in lost.items():
        expected[t] = np.linalg.solve(solver.normal, right[t] + matrix @ expected[t])
    np.testing.assert_allclose(found[[3, 9, 12, 13]], expected[[3, 9, 12, 13]], rtol=0, atol=1e-7)


def test_gaps_alone_are_interpolated_and_others_stay(solver, smoother):
    time = np.arange(FRAMES)[:, None, None]
    cages = solver.rest_cage + time * np.array([0.1, 0.0, 0.0])
    known = np.ones(FRAMES, bool)
    known[10:13] = False
    spoilt = np.where(known[:, None, None], cages, 0.0)
    found = smoother.fill(FrameTerms(spoilt, known, {}), noise=1e-6)
    np.testing.assert_allclose(found, cages, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(found[known], cages[known])


def test_validation_finds_noise_and_spares_clean_motion(solver, smoother):
    clean, _ = make_cages(solver, count=80)
    noise = 0.02**2 * 3
    vertices = len(solver.rest)
    spoilt = clean + np.linalg.solve(
        np.linalg.cholesky(solver.normal).T,
        RNG.standard_normal(clean.shape) * np.sqrt(noise / 3 * solver.data_scale),
    )
    gamma = smoother.choose_strength(*smoother.measure_validation(spoilt), noise * 80, 80)
    smooth = smoother.smooth(spoilt, np.ones(80, bool), gamma)
    error, before = (np.abs(one - clean).mean() for one in (smooth, spoilt))
    assert error < 0.6 * before
    tiny = smoother.choose_strength(*smoother.measure_validation(clean), 1e-8 * 80, 80)
    assert np.abs(smoother.smooth(clean, np.ones(80, bool), tiny) - clean).max() < 1e-3
    assert vertices > 0


def test_the_added_residual_and_the_freedom_are_those_of_the_smoothing(solver):
    smoother = TimeSmoother(solver, hit_ratio=1e9)
    _, cages = make_cages(solver)
    added, freedom = smoother.measure_validation(cages)
    place = 20
    smooth = smoother.smooth(cages, np.ones(FRAMES, bool), STRENGTHS[place] * smoother.scale)
    moved = smooth - cages
    total = np.einsum("tix,ij,tjx->", moved, solver.normal, moved)
    np.testing.assert_allclose(added[place], total, rtol=1e-6)
    assert (np.diff(added) >= 0).all()
    assert (np.diff(freedom) <= 0).all()


def test_a_hit_survives(solver, smoother):
    clean, cages = make_cages(solver, noise=0.005, count=80)
    hit = 0.8 * np.exp(-(((np.arange(80) - 40) / 1.2) ** 2))[:, None, None] * np.array([0, 1.0, 0])
    known = np.ones(80, bool)
    found = smoother.smooth(cages + hit, known, smoother.convert_length(1.5))
    speed = [np.abs(np.diff(one[:, 0, 1])).max() for one in (found, clean + hit)]
    assert speed[0] > 0.95 * speed[1]


def test_windows_give_what_the_whole_gives(solver):
    smoother = TimeSmoother(solver, hit_ratio=1e9)
    _, cages = make_cages(solver, count=400)
    known = np.ones(400, bool)
    gamma = smoother.convert_length(1.0)
    whole = smoother.smooth(cages, known, gamma)
    part = smoother.smooth(cages[100:300], known[100:300], gamma)
    inner = slice(MIN_WINDOW // 4, -MIN_WINDOW // 4)
    assert np.abs(part[inner] - whole[100:300][inner]).max() < 1e-2 * np.abs(whole - cages).max()
