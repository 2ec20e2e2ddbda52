"""Fitted weights that lower the largest deviations: what they gain, and what must not change."""

from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.fit import norm as norms
from cageik_cli.fit.fit import Fitter
from cageik_cli.fit.norm import lower_deviations
from cageik_cli.fit.problem import Displacements
from cageik_cli.fit.settings import FitSettings, Strength
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.solve.vertex_weights import normalize_weights
from tests.fitted import Frames, small_binding, smooth_motion

BINDING = small_binding(3)
CLIP = smooth_motion(BINDING, 40)
GIVEN = FitSettings(regularization=0.1)
SIX, PLAIN = SolveSettings(norm=6), SolveSettings(norm=2)


def fit(clip=CLIP, settings=GIVEN, solve=SIX, **others):
    return Fitter(BINDING, settings, solve=solve, **others).fit([Frames(clip)])


def prepare(clip=CLIP, vertex_weights=None):
    """Return an alternator, the frames and the change that fits them by least squares."""
    fitter = Fitter(BINDING, GIVEN, vertex_weights=vertex_weights)
    sample = fitter.sample([Frames(clip)])
    alternator = fitter.make_alternator(sample, Strength(0.1, 1.0))
    return alternator, sample.target, alternator.fit_full_rank(sample.target)


def lower(alternator, target, change, norm=6, **rounds):
    return lower_deviations(
        alternator.problem, alternator.cage_solve, target, change, norm, **rounds
    )


def measure(alternator, target, change):
    """Return the deviations, (m, k), in cages of least squares."""
    weights = alternator.problem.add_change(change)
    solver = alternator.cage_solve.prepare(weights)
    errors = [block - weights @ solver.solve_displacements(block) for block in target.blocks()]
    return np.linalg.norm(np.hstack(errors).reshape(len(weights), -1, 3), axis=2)


def test_weights_and_cages_lower_the_largest_deviation_more_than_cages_alone():
    """The error of the clip does not rise."""
    plain, cages = fit(solve=PLAIN), replace(SIX)
    alone = Fitter(BINDING, GIVEN, solve=cages).cage_solve
    sample = Fitter(BINDING, GIVEN).sample([Frames(CLIP)])
    both = fit().report.fitted.fitted
    only_cages = alone.measure(plain.binding.weights, sample.target)
    least_squares = plain.report.fitted.fitted
    assert only_cages.largest < 0.95 * least_squares.largest
    assert both.largest < 0.9 * only_cages.largest
    assert both.rms < 1.02 * least_squares.rms


def test_weights_of_one_would_change_little(monkeypatch):
    """The check above can fail: least squares are fitted already."""
    alternator, target, change = prepare()
    largest = measure(alternator, target, change).max()
    assert measure(alternator, target, lower(alternator, target, change)).max() < 0.9 * largest
    monkeypatch.setattr(norms, "weigh_deviations", lambda lengths, limit, norm: 1 + 0 * lengths)
    assert measure(alternator, target, lower(alternator, target, change)).max() > 0.97 * largest


def test_rounds_lower_the_sum_that_they_minimise():
    alternator, target, change = prepare()
    lengths = measure(alternator, target, change)
    limit = norms.ROW_LIMIT_RATIO * np.sqrt(np.mean(lengths**2))

    def cost(change):
        lengths = measure(alternator, target, change) / limit
        return (np.minimum(lengths, 1) ** 2 + 2 / 6 * (np.maximum(lengths, 1) ** 6 - 1)).sum()

    costs = [cost(change), *(cost(lower(alternator, target, change, rounds=k)) for k in (1, 3, 6))]
    assert costs[1] < 0.9 * costs[0]
    assert costs == sorted(costs, reverse=True)


def test_the_rest_pose_stays_exact():
    found = fit().binding.quality
    assert found.partition_of_unity < 1e-12
    assert found.linear_precision < 1e-12


def test_threads_do_not_change_a_bit():
    np.testing.assert_array_equal(fit(jobs=3).binding.weights, fit().binding.weights)


def test_frames_that_are_fitted_exactly_stay_so():
    """Nothing deviates: no weight is divided by."""
    still = np.repeat(BINDING.rest.vertices[None], 12, axis=0)
    np.testing.assert_allclose(fit(still).binding.weights, BINDING.weights, rtol=0, atol=1e-9)


def test_frames_in_single_precision_give_nearly_the_same():
    alternator, target, change = prepare()
    single = replace(target, parts=tuple(part.astype(np.float32) for part in target.parts))
    found, expected = lower(alternator, single, change), lower(alternator, target, change)
    moved = [alternator.problem.add_change(one) for one in (found, expected)]
    assert 0 < np.abs(moved[0] - moved[1]).max() < 1e-4


def test_some_of_the_frames_are_fitted_as_if_there_were_no_others():
    alternator, target, change = prepare()
    chosen = np.array([1, 2, 3, 17, 18, 30, 39])
    some = target.take(chosen)
    alone = Displacements.of(np.hstack(list(some.blocks())))
    found, expected = (lower(alternator, one, change) for one in (some, alone))
    moved = [alternator.problem.add_change(one) for one in (found, expected)]
    np.testing.assert_allclose(moved[0], moved[1], atol=1e-9)


def test_a_frame_that_stands_for_others_counts_as_they_do():
    """Twice the frame is a share of two: the columns are scaled, its deviations are not."""
    alternator, target, change = prepare(CLIP[:20])
    frames = [np.hstack(list(target.take(np.array([k])).blocks())) for k in range(20)]
    twice = Displacements.join([frame.copy() for frame in (*frames, *frames[:5])], np.ones(25))
    shared = Displacements.join([frame.copy() for frame in frames], np.repeat([2.0, 1.0], (5, 15)))
    found, expected = (lower(alternator, one, change) for one in (shared, twice))
    moved = [alternator.problem.add_change(one) for one in (found, expected)]
    np.testing.assert_allclose(moved[0], moved[1], atol=1e-7)


def test_missing_vertices_do_not_count():
    m = len(BINDING.weights)
    counts = normalize_weights(np.where(np.arange(m) < 9, 0.0, 1.0), m)
    elsewhere = CLIP.copy()
    elsewhere[:, :9] += 1
    weights = [fit(clip, vertex_weights=counts).binding.weights for clip in (CLIP, elsewhere)]
    np.testing.assert_allclose(weights[0], weights[1], atol=1e-6)


@pytest.mark.parametrize("settings", [FitSettings(rank=4), FitSettings(influences=4)])
def test_weights_of_few_numbers_are_those_of_least_squares(settings):
    found, expected = fit(settings=settings), fit(settings=settings, solve=PLAIN)
    np.testing.assert_array_equal(found.binding.weights, expected.binding.weights)
    assert found.report.fitted.fitted.largest < expected.report.fitted.fitted.largest


def test_frames_held_out_are_measured_in_the_same_norm():
    """Of weights that lower the deviations of the frames seen, as the others do."""
    even, plain = (
        fit(settings=FitSettings()).report,
        fit(settings=FitSettings(), solve=PLAIN).report,
    )
    assert even.held_out_blocks.fitted.largest < plain.held_out_blocks.fitted.largest
    assert even.held_out_blocks.fitted.rms < 1.03 * plain.held_out_blocks.fitted.rms
