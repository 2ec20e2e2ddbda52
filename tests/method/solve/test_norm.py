"""Cages whose largest deviations are lowered: against an oracle, and what must not change."""

import numpy as np
import pytest
from scipy.optimize import minimize

from cageik_cli.method.solve import norm as norms
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.norm import LIMIT_RATIO, MIN_LIMIT, DeviationNorm, weigh_deviations
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.solve.vertex_weights import normalize_weights
from cageik_cli.method.weights.binding import Binding
from cageik_cli.util.errors import SettingError
from tests.method.solve.test_dual_laplacian import CAGE, binding, clip
from tests.shapes import rotation

__all__ = ["binding"]  # the fixture


def spiked(binding, count=4):
    """Frames of the smooth motion in which a few vertices, others in each, are far off."""
    frames = clip(binding, count + 1)[1:]
    generator = np.random.default_rng(3)
    for frame in frames:
        some = generator.choice(len(frame), 6, replace=False)
        frame[some] += 0.1 * generator.normal(size=(6, 3))
    return frames


def measure(solver, frames):
    """Return the deviations, (k, m)."""
    return np.linalg.norm(solver.solve(frames).reconstructions - frames, axis=2)


def test_the_largest_deviation_falls_and_the_mean_grows_little(binding):
    frames = spiked(binding)
    plain = measure(DualLaplacianSolver(binding, SolveSettings()), frames)
    found = [measure(DualLaplacianSolver(binding, SolveSettings(norm=p)), frames) for p in (4, 6)]
    largest = [deviations.max(axis=1) for deviations in (plain, *found)]
    assert (largest[1] < 0.95 * largest[0]).all()
    assert (largest[2] < 0.9 * largest[0]).all()
    assert (largest[2] < largest[1]).all()
    rms = [np.sqrt(np.mean(deviations**2, axis=1)) for deviations in (plain, *found)]
    assert (rms[0] < rms[1]).all()
    assert (rms[2] < 1.4 * rms[0]).all()


def test_weights_of_one_would_change_nothing(binding, monkeypatch):
    """The check above can fail: without the weights, the cage of least squares is the best."""
    monkeypatch.setattr(norms, "weigh_deviations", lambda lengths, limit, norm: 1 + 0 * lengths)
    frames = spiked(binding)
    plain = DualLaplacianSolver(binding, SolveSettings()).solve(frames).cages
    found = DualLaplacianSolver(binding, SolveSettings(norm=6)).solve(frames).cages
    np.testing.assert_allclose(found, plain, atol=1e-12)


@pytest.mark.parametrize("power", [3, 6, 8])
def test_the_cage_is_the_minimum_of_the_objective(binding, power, monkeypatch):
    """Oracle: a general minimiser, on the objective as it stands in the paper of the module."""
    monkeypatch.setattr(norms, "MOVE_TOL", 1e-9)
    monkeypatch.setattr(norms, "MAX_CAGE_ROUNDS", 300)
    m = len(binding.weights)
    counts = normalize_weights(np.linspace(0.5, 1.5, m), m)
    settings = SolveSettings(alpha=0.01, align=False, norm=power)
    solver = DualLaplacianSolver(binding, settings, counts)
    frame = spiked(binding, 1)[0]
    target = frame - binding.rest.vertices
    plain = solver.solve_displacements(target)
    least = np.linalg.norm(target - binding.weights @ plain, axis=1)
    limit = LIMIT_RATIO * np.sqrt(counts @ least**2 / m)

    def objective(entries):
        moved = entries.reshape(-1, 3)
        lengths = np.linalg.norm(target - binding.weights @ moved, axis=1)
        ratio = np.maximum(lengths / limit, 1)
        costs = np.minimum(lengths, limit) ** 2 + 2 / power * limit**2 * (ratio**power - 1)
        return np.vdot(moved, solver.smoothness @ moved) + solver.data_scale * counts @ costs

    found = solver.solve_frames(target)
    assert (least > limit).any()
    assert objective(found.ravel()) < 0.999 * objective(plain.ravel())
    best = minimize(objective, found.ravel(), method="L-BFGS-B", tol=1e-16)
    assert objective(found.ravel()) <= best.fun * (1 + 1e-7)


def test_frames_with_nothing_far_off_keep_the_cages_of_least_squares(binding):
    """To the last bit; also beside others in a block, and where nothing deviates at all."""
    generator = np.random.default_rng(1)
    cages = CAGE.vertices + 0.1 * generator.normal(size=(2, *CAGE.vertices.shape))
    exact = binding.weights @ cages
    frames = np.concatenate([binding.rest.vertices[None], exact, spiked(binding)])
    plain = DualLaplacianSolver(binding, SolveSettings(alpha=0)).solve(frames)
    found = DualLaplacianSolver(binding, SolveSettings(alpha=0, norm=6)).solve(frames)
    assert np.array_equal(found.cages[:3], plain.cages[:3])
    assert np.array_equal(found.reconstructions[:3], plain.reconstructions[:3])
    assert not np.isclose(found.cages[3:], plain.cages[3:], atol=1e-6).all(axis=(1, 2)).any()


def test_the_norm_of_least_squares_corrects_nothing(binding):
    frames = spiked(binding)
    default = DualLaplacianSolver(binding, SolveSettings()).solve(frames)
    stated = DualLaplacianSolver(binding, SolveSettings(norm=2)).solve(frames)
    assert np.array_equal(stated.cages, default.cages)
    target = DualLaplacianSolver(binding, SolveSettings()).align(frames)[0]
    solver = DualLaplacianSolver(binding, SolveSettings(norm=2))
    assert np.array_equal(solver.solve_frames(target), solver.solve_displacements(target))


def test_rigid_motions_commute_with_the_solve(binding):
    solver, frames = DualLaplacianSolver(binding, SolveSettings(norm=6)), spiked(binding)
    cages = solver.solve(frames).cages
    for k, frame in enumerate(frames):
        turn, shift = rotation(50 + k), np.array([10.0, -k, 7])
        moved = solver.solve((frame @ turn.T + shift)[None]).cages[0]
        np.testing.assert_allclose(moved, cages[k] @ turn.T + shift, atol=1e-9)


def test_frames_solved_together_are_those_solved_one_by_one(binding):
    solver, frames = DualLaplacianSolver(binding, SolveSettings(norm=6)), spiked(binding)
    alone = np.concatenate([solver.solve(frame[None]).cages for frame in frames])
    np.testing.assert_allclose(solver.solve(frames).cages, alone, atol=1e-11)


def test_vertices_that_come_above_the_limit_in_the_rounds_are_followed(binding, monkeypatch):
    """All vertices are looked through again: the same cage as where all are followed at once."""
    frames = spiked(binding)
    monkeypatch.setattr(norms, "MOVE_TOL", 1e-9)
    monkeypatch.setattr(norms, "MAX_CAGE_ROUNDS", 300)
    monkeypatch.setattr(norms, "FOLLOWED_RATIO", 0.0)
    every = DualLaplacianSolver(binding, SolveSettings(norm=6)).solve(frames).cages
    monkeypatch.setattr(norms, "FOLLOWED_RATIO", 0.999)
    found = DualLaplacianSolver(binding, SolveSettings(norm=6)).solve(frames).cages
    np.testing.assert_allclose(found, every, atol=1e-6)
    monkeypatch.setattr(norms, "MAX_SEARCHES", 1)
    once = DualLaplacianSolver(binding, SolveSettings(norm=6)).solve(frames).cages
    assert np.abs(once - every).max() > 1e-5


def test_vertices_of_weight_0_are_not_followed(binding):
    """They may be anywhere."""
    m = len(binding.weights)
    counts = normalize_weights(np.where(np.arange(m) < 20, 0.0, 1.0), m)
    solver = DualLaplacianSolver(binding, SolveSettings(norm=6), counts)
    frames = spiked(binding)
    elsewhere = frames.copy()
    elsewhere[:, :20] += 5
    found, moved = solver.solve(frames).cages, solver.solve(elsewhere).cages
    np.testing.assert_allclose(moved, found, atol=1e-12)


def test_offsets_of_few_influences_are_no_deviations(binding):
    """Their rest pose is met exactly, and stays the rest cage."""
    rough = np.round(binding.weights, 1)
    rough /= rough.sum(axis=1, keepdims=True)
    few = Binding(binding.rest, binding.cage, rough, has_offsets=True)
    solver = DualLaplacianSolver(few, SolveSettings(norm=6))
    found = solver.solve(binding.rest.vertices[None]).cages[0]
    np.testing.assert_allclose(found, CAGE.vertices, atol=1e-12)
    frames = spiked(binding)
    plain = measure(DualLaplacianSolver(few, SolveSettings()), frames)
    assert (measure(solver, frames).max(axis=1) < 0.95 * plain.max(axis=1)).all()


def test_deviations_below_all_rounding_are_left(binding):
    """Files round more: there is nothing to lower."""
    correct = DeviationNorm(
        6,
        normal=np.eye(2),
        weights=np.full((4, 2), 0.5),
        vertex_weights=np.ones(4),
        data_scale=0.25,
        least=MIN_LIMIT,
    ).correct
    spike = np.zeros((4, 3))
    spike[0] = 1
    assert not correct(0.5 * MIN_LIMIT * spike).any()
    assert not correct(0 * spike).any()


def test_weights_begin_at_one_and_grow_with_a_power():
    np.testing.assert_allclose(weigh_deviations(np.array([0, 1, 2, 4.0]), 2.0, 6), [1, 1, 1, 16])


@pytest.mark.parametrize("value", [1.9, 0, -3, 12.5, float("nan"), float("inf")])
def test_other_norms_are_refused(value):
    with pytest.raises(SettingError, match=r"`norm=` is .*, expected 2 to 8"):
        SolveSettings(norm=value)
