"""Cages smoothed over time: rigid motions apart, cross-validation, hits and windows."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cageik_cli import bind
from cageik_cli.captured import smooth
from cageik_cli.captured.fill import FrameTerms, TimeFiller
from cageik_cli.captured.settings import MAX_SMOOTHING_PERIOD
from cageik_cli.captured.smooth import MIN_WINDOW, STRENGTHS, TimeSmoother, choose_strengths
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from tests.shapes import ball, box

RNG = np.random.default_rng(11)
FRAMES = 80


@pytest.fixture(scope="module")
def solver():
    binding = bind(ball(levels=2, size=1.0), box(2.0), coordinates="mean-value")
    return DualLaplacianSolver(binding, SolveSettings())


@pytest.fixture
def smoother(solver):
    return TimeSmoother(solver)


def make_cages(solver, count=FRAMES):
    """Cages that swell, drift, and bend at one vertex."""
    time = np.linspace(0, 2 * np.pi, count)[:, None, None]
    cages = solver.rest_cage * (1 + 0.2 * np.sin(time)) + [1.0, 0.0, 0.0] * time
    cages[:, 3, 1] += 0.3 * np.sin(2 * time[:, 0, 0])
    return cages


def make_terms(cages, **changes):
    known = np.ones(len(cages), bool)
    return FrameTerms(**{"cages": cages, "is_known": known, "lost": {}} | changes)


def smooth_terms(smoother, cages, terms, strengths):
    return smoother.smooth(cages, smoother.measure_shares(terms), strengths)


def validate(smoother, cages):
    return smoother.measure_validation(cages, np.ones(len(cages), bool))


def smooth_auto(smoother, cages):
    strengths = choose_strengths(*validate(smoother, cages), len(cages))
    return smooth_terms(smoother, cages, make_terms(cages), strengths)


def turn(cages, angles):
    return cages @ Rotation.from_euler("y", np.reshape(angles, (-1, 1))).as_matrix().swapaxes(1, 2)


def test_a_body_that_turns_keeps_its_size_and_place(solver, smoother):
    """Once in 24 frames, smoothed with just that period."""
    angles = 2 * np.pi * np.arange(FRAMES) / 24
    cages = turn(np.tile(solver.rest_cage, (FRAMES, 1, 1)), angles)
    found = smooth_terms(smoother, cages, make_terms(cages), smoother.repeat_period(24))
    inner = slice(24, -24)
    np.testing.assert_allclose(found[inner], cages[inner], rtol=0, atol=5e-3)
    sizes = [np.linalg.norm(one - one.mean(axis=1, keepdims=True)) for one in (found, cages)]
    np.testing.assert_allclose(*sizes, rtol=1e-12)


@pytest.mark.parametrize("gap", [1, 10])
def test_gaps_of_a_body_that_turns_and_travels_are_filled_without_shrinking(solver, smoother, gap):
    """It turns once in 24 frames, so that it turns by 165 degrees in the longer gap."""
    time = np.arange(FRAMES)[:, None, None]
    cages = turn(np.tile(solver.rest_cage, (FRAMES, 1, 1)), 2 * np.pi * time / 24)
    cages = cages + time * np.array([0.1, 0.0, 0.0])
    known = np.ones(FRAMES, bool)
    known[30 : 30 + gap] = False
    spoilt = np.where(known[:, None, None], cages, 0.0)
    found = smoother.fill(spoilt, known)
    np.testing.assert_array_equal(found[known], cages[known])
    np.testing.assert_allclose(found, cages, rtol=0, atol=2e-2)
    sizes = [np.linalg.norm(one - one.mean(axis=1, keepdims=True)) for one in (found, cages)]
    np.testing.assert_allclose(*sizes, rtol=1e-12)


def test_gaps_bend_least_over_time(solver, smoother):
    """A vertex that moves in the aligned cage, against a dense solve of what is between data."""
    shift = 0.1 * np.sin(0.3 * np.arange(30.0))
    cages = solver.rest_cage + np.outer(shift, [1.0, 0.0, 0.0])[:, None]
    known = np.ones(30, bool)
    known[[4, 5, 17]] = False
    second = np.diff(np.eye(30), 2, axis=0)
    inner, rest = second[:, ~known], second[:, known] @ shift[known]
    expected = np.linalg.lstsq(inner, -rest, rcond=None)[0]
    found = smoother.fill(cages, known)[~known] - solver.rest_cage
    np.testing.assert_allclose(found[..., 0], expected[:, None] + np.zeros(8), rtol=0, atol=1e-7)


def test_frames_beyond_the_data_stay(solver, smoother):
    cages, known = make_cages(solver, 12), np.zeros(12, bool)
    known[[4, 5, 8]] = True
    found = smoother.fill(cages, known)
    np.testing.assert_array_equal(np.delete(found, [6, 7], 0), np.delete(cages, [6, 7], 0))
    assert np.abs(found[6:8] - cages[6:8]).max() > 1e-3


def test_a_motion_of_the_stated_period_is_halved(solver, smoother):
    shift = 0.1 * np.sin(2 * np.pi * np.arange(240) / 24)[:, None, None] * np.array([1.0, 0, 0])
    cages = solver.rest_cage + shift
    found = smooth_terms(smoother, cages, make_terms(cages), smoother.repeat_period(24))
    middle = slice(96, 144)
    np.testing.assert_allclose(
        found[middle] - solver.rest_cage, (shift / 2)[middle] + np.zeros((8, 1)), rtol=0, atol=2e-3
    )


def test_smoothing_turns_with_the_clip(solver, smoother):
    cages = make_cages(solver) + 0.02 * RNG.standard_normal((FRAMES, 8, 3))
    angles, shift = np.full(FRAMES, 1.1), np.array([3.0, -2.0, 1.0])
    turned = turn(cages, angles) + shift
    expected = turn(smooth_auto(smoother, cages), angles) + shift
    np.testing.assert_allclose(smooth_auto(smoother, turned), expected, rtol=0, atol=1e-9)


def test_a_track_is_the_minimum_over_all_frames(solver, smoother, monkeypatch):
    """A vertex that moves in the aligned cage, against a dense solve; gaps have no weight."""
    monkeypatch.setattr(smooth, "MIN_HIT_RATIO", 1e9)
    centres = make_cages(solver, 30).mean(axis=1, keepdims=True)
    centres += 0.02 * RNG.standard_normal(centres.shape)
    cages = solver.rest_cage + centres - solver.rest_cage.mean(axis=0)
    known = np.ones(30, bool)
    known[[4, 5, 17]] = False
    second = np.diff(np.eye(30), 2, axis=0)
    strength = smoother.repeat_period(9.0)
    system = np.diag(known.astype(float)) + strength[0] * second.T @ second
    expected = np.linalg.solve(system, known[:, None] * centres[:, 0])
    found = smooth_terms(smoother, cages, make_terms(cages, is_known=known), strength)
    np.testing.assert_allclose(found.mean(axis=1), expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("kind", ["jitter", "patches"])
def test_what_trembles_alike_is_found_and_clean_motion_is_spared(solver, smoother, kind):
    clean = make_cages(solver)
    spoilt = turn(clean, 0.01 * RNG.standard_normal(FRAMES))
    spoilt += 0.02 * RNG.standard_normal((FRAMES, 1, 3))
    if kind == "patches":
        spoilt = clean.copy()
        spoilt[:, :2] += 0.02 * RNG.standard_normal((FRAMES, 1, 3))
    found, untouched = smooth_auto(smoother, spoilt), smooth_auto(smoother, clean)
    error, before = (np.sqrt(((one - clean) ** 2).mean()) for one in (found, spoilt))
    assert error < 0.6 * before
    assert np.abs(untouched - clean).max() < 1e-3


def test_three_frames_are_not_smoothed_by_chance(solver, smoother):
    strengths = choose_strengths(*validate(smoother, make_cages(solver)[:3]), 3)
    np.testing.assert_array_equal(strengths, STRENGTHS[0])


def test_what_is_taken_and_left_is_that_of_the_smoothing(solver, smoother, monkeypatch):
    monkeypatch.setattr(smooth, "MIN_HIT_RATIO", 1e9)
    cages = make_cages(solver) + 0.02 * RNG.standard_normal((FRAMES, 8, 3))
    taken, freedom = validate(smoother, cages)
    second = np.diff(np.eye(FRAMES), 2, axis=0)
    moved = np.linalg.inv(np.eye(FRAMES) + STRENGTHS[12] * second.T @ second)
    np.testing.assert_allclose(freedom[12], np.trace(moved), rtol=1e-9)
    centres = cages @ np.eye(3)
    centres = np.einsum("i,tix->tx", smoother._mean, centres)
    np.testing.assert_allclose(
        taken[0, 12], ((centres - moved @ centres) ** 2).sum(), rtol=1e-6, atol=0
    )
    assert (np.diff(taken, axis=1) >= 0).all()


def test_frames_that_are_filled_are_no_data_for_validation(solver, smoother):
    """Against a dense solve over all frames of which only the known ones have weight."""
    cages = make_cages(solver) + 0.02 * RNG.standard_normal((FRAMES, 8, 3))
    known = RNG.random(FRAMES) < 0.5
    known[:5], known[30:50] = False, False
    taken, freedom = smoother.measure_validation(cages, known)
    second = np.diff(np.eye(FRAMES), 2, axis=0)
    share = np.diag(known.astype(float))
    moved = np.linalg.inv(share + STRENGTHS[12] * second.T @ second) @ share
    np.testing.assert_allclose(freedom[12], np.trace(moved[known][:, known]), rtol=1e-7)
    centres = np.einsum("i,tix->tx", smoother._mean, cages)
    changes = (centres - moved @ centres)[known]
    np.testing.assert_allclose(taken[0, 12], (changes**2).sum(), rtol=1e-6, atol=0)
    cages[~known] += 9.0
    np.testing.assert_allclose(smoother.measure_validation(cages, known)[0][0], taken[0])


def test_noise_is_found_if_every_second_frame_is_missing(solver, smoother):
    clean = make_cages(solver, 2 * FRAMES)
    cages = clean + 0.02 * RNG.standard_normal((2 * FRAMES, 1, 3))
    known = np.arange(2 * FRAMES) % 2 == 0
    terms = make_terms(cages, is_known=known)
    filled = TimeFiller(solver).fill(terms)
    strengths = choose_strengths(*smoother.measure_validation(filled, known), FRAMES)
    assert strengths[0] > 1e3 * STRENGTHS[0]
    found = smooth_terms(smoother, filled, terms, strengths)
    errors = [np.sqrt(((one - clean) ** 2).mean()) for one in (found, filled)]
    assert errors[0] < 0.6 * errors[1]


def test_a_vertex_with_little_data_in_a_frame_follows_its_time(solver, smoother):
    cages = make_cages(solver)
    spoilt = cages + 0.02 * RNG.standard_normal(cages.shape)
    spoilt[40, 3] = cages[40, 3] + [0.0, 0.1, 0.0]
    rows = np.argsort(-solver.binding.weights[:, 3])[:40]
    lost = {40: solver.weigh_data(np.ones(40), rows)}
    strengths = np.full(10, STRENGTHS[2])
    found = [
        smooth_terms(smoother, spoilt, make_terms(spoilt, lost=one), strengths)[40, 3]
        - cages[40, 3]
        for one in (lost, {})
    ]
    assert np.linalg.norm(found[0]) < 0.8 * np.linalg.norm(found[1])


@pytest.mark.parametrize("vertices", [slice(None), slice(0, 2)])
def test_a_hit_survives(solver, smoother, vertices):
    clean = make_cages(solver)
    hit = 0.8 * np.exp(-(((np.arange(FRAMES) - 40) / 1.2) ** 2))[:, None, None] * [0, 1.0, 0]
    clean[:, vertices] += hit
    cages = clean + 0.005 * RNG.standard_normal(clean.shape)
    found = smooth_terms(smoother, cages, make_terms(cages), smoother.repeat_period(9.0))
    speed = [np.abs(np.diff(one[:, 0, 1])).max() for one in (found, clean)]
    assert speed[0] > 0.95 * speed[1]


@pytest.mark.parametrize("gap", [slice(0, 40), slice(40, 80)])
@pytest.mark.parametrize("frames", [1.0, 9.0, 199.0])
def test_half_a_clip_without_data_does_not_make_hits_of_the_rest(solver, smoother, gap, frames):
    """As a gap that is filled has no acceleration, it says nothing of what is usual."""
    cages = make_cages(solver) + 0.02 * RNG.standard_normal((FRAMES, 8, 3))
    known = np.ones(FRAMES, bool)
    known[gap] = False
    terms = make_terms(cages, is_known=known)
    filled, strengths = TimeFiller(solver).fill(terms), smoother.repeat_period(frames)
    found = smooth_terms(smoother, filled, terms, strengths)[known]
    alone = smooth_terms(smoother, cages[known], make_terms(cages[known]), strengths)
    np.testing.assert_allclose(found, alone, rtol=0, atol=1e-2 * np.abs(alone - cages[known]).max())


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_few_frames_at_an_end_of_a_window_are_solved(solver, smoother, count):
    cages, known = make_cages(solver, 512), np.arange(512) < count
    terms = make_terms(cages, is_known=known)
    found = smooth_terms(
        smoother,
        TimeFiller(solver).fill(terms),
        terms,
        smoother.repeat_period(MAX_SMOOTHING_PERIOD),
    )
    np.testing.assert_allclose(found[known], cages[known], rtol=0, atol=1e-3)


def test_gaps_by_turns_are_smoothed_over(solver, smoother):
    clean = make_cages(solver, 280)
    cages = clean + 0.02 * RNG.standard_normal(clean.shape)
    known = np.arange(280) % 70 < 30
    terms = make_terms(cages, is_known=known)
    filled = TimeFiller(solver).fill(terms)
    found = smooth_terms(smoother, filled, terms, smoother.repeat_period(24))[known] - clean[known]
    assert np.sqrt((found**2).mean()) < 0.5 * np.sqrt(((cages - clean)[known] ** 2).mean())


def test_a_hit_is_not_found_where_frames_are_filled(solver, smoother):
    tracks = np.zeros((30, 10, 4))
    tracks[:, 0, 0] = 0.01 * np.arange(30) ** 2
    tracks[:, 2:, 0] = 1.0
    tracks[20, 0, 0] += 5
    known = np.ones(30, bool)
    assert (smooth.weigh_accelerations(tracks, known)[17:22] < 0.01).all()
    known[20] = False
    assert smooth.weigh_accelerations(tracks, known)[19] == 1


def test_a_jump_survives_where_every_second_frame_is_filled(solver, smoother):
    cages, known = make_cages(solver), np.arange(FRAMES) % 2 == 0
    cages[40:] += [0.0, 2.0, 0.0]
    terms = make_terms(cages, is_known=known)
    filled = TimeFiller(solver).fill(terms)
    found = smooth_terms(smoother, filled, terms, smoother.repeat_period(9.0))
    assert np.abs((found - cages)[known]).max() < 0.02


def test_windows_give_what_the_whole_gives(solver, smoother, monkeypatch):
    monkeypatch.setattr(smooth, "MIN_HIT_RATIO", 1e9)
    cages = make_cages(solver, 400)
    cages += 0.02 * RNG.standard_normal(cages.shape)
    strengths = smoother.repeat_period(6.0)
    whole = smooth_terms(smoother, cages, make_terms(cages), strengths)
    part = smooth_terms(smoother, cages[100:300], make_terms(cages[100:300]), strengths)
    inner = slice(MIN_WINDOW // 4, -MIN_WINDOW // 4)
    assert np.abs(part[inner] - whole[100:300][inner]).max() < 1e-2 * np.abs(whole - cages).max()
