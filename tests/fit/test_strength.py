"""The strength of a fit: which are tried, what ends the ladder, and what is recorded of it."""

from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.fit.fit import Fitter
from cageik_cli.fit.problem import estimate_memory
from cageik_cli.fit.settings import (
    DEFAULT_STRENGTH,
    MAX_EDIT_ROUGHNESS,
    EditRoughness,
    FitSettings,
    Strength,
    StrengthLimit,
    TriedStrength,
)
from cageik_cli.fit.strength import (
    LADDER,
    PLAYED_ROUNDS,
    PLAYED_TIMES,
    EditMeter,
    Rung,
    Trial,
    choose_ladder,
    climb,
)
from cageik_cli.method.weights.binding import Correction
from cageik_cli.report.fit_rows import list_fit_notes
from cageik_cli.run.api import extract
from cageik_cli.run.fit import fit_weights
from cageik_cli.util.errors import InputError, SettingError
from tests.fitted import Frames, small_binding, smooth_motion
from tests.refusals import refused

BINDING = small_binding()
CLIP = smooth_motion(BINDING, 60)
RUNGS = LADDER[:4]


def fit(frames=CLIP, **settings):
    return Fitter(BINDING, FitSettings(**settings)).fit([Frames(frames)])


def climb_with(errors, edits, use="edit"):
    """Climb four rungs whose errors, of blocks and of the third, and edits are given."""
    left = iter(errors)
    rough = iter(edits)
    return climb(RUNGS, lambda _: next(left), lambda: EditRoughness(next(rough), 1.0), use)


FALLING = [(8.0, 9.0), (4.0, 5.0), (2.0, 3.0), (1.0, 2.0)]
SMOOTH = [1.0, 1.01, 1.02, 1.03]


@pytest.mark.parametrize(
    ("errors", "edits", "use", "count", "limit"),
    [
        (FALLING, SMOOTH, "edit", 4, StrengthLimit.LADDER),
        (FALLING, [1.0, 1.1, 1.16, 1.2], "edit", 2, StrengthLimit.EDITS),
        (FALLING, [1.0, 1.1, 1.16, 1.2], "play", 4, StrengthLimit.LADDER),
        ([*FALLING[:2], (4.1, 4.0)], SMOOTH, "play", 2, StrengthLimit.KEPT_ASIDE),
        ([*FALLING[:2], (2.0, 5.2)], SMOOTH, "edit", 2, StrengthLimit.KEPT_ASIDE),
        ([*FALLING[:3], (2.0, 3.05)], SMOOTH, "edit", 3, StrengthLimit.GAIN),
        ([(1.0, None), (0.9, None), (0.9, None)], SMOOTH, "edit", 2, StrengthLimit.GAIN),
        ([(1.0, None), (1.1, None)], SMOOTH, "edit", 1, StrengthLimit.KEPT_ASIDE),
        # A little worse on one part is no reason against a gain on the other.
        ([(1.0, 1.0), (0.9, 1.015), (1.0, 1.0)], SMOOTH, "edit", 2, StrengthLimit.KEPT_ASIDE),
    ],
)
def test_the_ladder_ends_where_a_strength_is_worse(errors, edits, use, count, limit):
    found, why, tried = climb_with(errors, edits, use)
    assert (found, why) == (count, limit)
    assert len(tried) == min(count + 1, len(RUNGS))
    assert tried[0] == TriedStrength(*RUNGS[0].strength, *errors[0], EditRoughness(edits[0], 1.0))


@pytest.mark.parametrize(
    ("settings", "frames", "expected", "limit"),
    [
        ({}, 30, LADDER, StrengthLimit.LADDER),
        (
            {"use": "play"},
            5,
            (*LADDER, *PLAYED_TIMES * [LADDER[-1]._replace(rounds=PLAYED_ROUNDS)]),
            StrengthLimit.LADDER,
        ),
        ({}, 29, (Rung(DEFAULT_STRENGTH),), StrengthLimit.FRAMES),
        ({}, 8, (Rung(Strength(0.4, 1.0)),), StrengthLimit.FRAMES),
        ({}, 0, (Rung(Strength(25.6, 1.0)),), StrengthLimit.FRAMES),
        ({"influences": 4}, 99, (Rung(DEFAULT_STRENGTH),), StrengthLimit.INFLUENCES),
        ({"regularization": 0.2}, 8, (Rung(Strength(0.2, 1.0)),), StrengthLimit.GIVEN),
        (
            {"regularization": 0.2, "smoothness": 0.0},
            99,
            (Rung(Strength(0.2, 0.0)),),
            StrengthLimit.GIVEN,
        ),
        ({"smoothness": 2.0}, 29, (Rung(Strength(0.1, 2.0)),), StrengthLimit.FRAMES),
    ],
)
def test_the_strengths_that_are_tried(settings, frames, expected, limit):
    assert choose_ladder(FitSettings(**settings), frames) == (expected, limit)


def test_a_smoothness_that_is_given_alone_stays():
    ladder, _ = choose_ladder(FitSettings(smoothness=0.5), 99)
    assert [rung.strength.smoothness for rung in ladder] == 5 * [0.5]
    pulls = [rung.strength.regularization for rung in ladder]
    assert pulls == sorted(set(pulls), reverse=True)


@pytest.mark.parametrize(
    ("lacks", "limit"),
    [("can_hold_out", StrengthLimit.NONE_ASIDE), ("has_memory", StrengthLimit.MEMORY)],
)
@pytest.mark.parametrize("smoothness", [None, 0.5])
def test_a_smoothness_that_is_given_stays_where_nothing_can_be_tried(lacks, limit, smoothness):
    settings = FitSettings(smoothness=smoothness)
    found = choose_ladder(settings, 99, **{lacks: False})
    assert found == ((Rung(Strength(0.1, smoothness or 1.0)),), limit)


def test_the_last_strength_is_repeated_for_play_with_any_smoothness():
    ladder, _ = choose_ladder(FitSettings(use="play", smoothness=0.5), 5)
    assert [rung.rounds for rung in ladder[-PLAYED_TIMES:]] == PLAYED_TIMES * [PLAYED_ROUNDS]


def test_edits_that_stay_too_rough_are_noted():
    found = fit(CLIP[:20])
    assert found.report.limit is StrengthLimit.FRAMES
    for edits, is_noted in ((EditRoughness(1.15, 1.0), False), (EditRoughness(1.0, 1.3), True)):
        record = replace(found.fit, report=replace(found.report, edits=edits))
        notes = [str(note) for note in list_fit_notes(record)]
        assert any("1.30 times as rough" in note for note in notes) == is_noted


def test_no_clips_are_refused():
    with refused(InputError, "no frame can be read"):
        fit_weights(BINDING, [])


def test_the_default_is_closer_where_nothing_was_seen_and_keeps_edits_smooth():
    """Frames between those of the fit, which neither choice has seen."""
    chosen, given = fit(CLIP[::2]), fit(CLIP[::2], regularization=0.1)
    assert chosen.report.distinct_frames == 30
    errors = [extract(CLIP[1::2], one.binding).rms_percent for one in (chosen, given)]
    assert errors[0] < 0.6 * errors[1]
    report = chosen.report
    assert report.edits.largest <= MAX_EDIT_ROUGHNESS
    assert len(report.ladder) > 3
    assert Strength(report.regularization, report.smoothness) in [
        (one.regularization, one.smoothness) for one in report.ladder
    ]


def test_what_is_reported_is_measured_on_the_weights_of_the_chosen_strength():
    found = fit()
    report = found.report
    by_strength = {(one.regularization, one.smoothness): one for one in report.ladder}
    chosen = by_strength[report.regularization, report.smoothness]
    assert report.held_out_blocks.fitted.rms == pytest.approx(chosen.held_out_blocks, rel=1e-9)
    assert report.unseen_third.fitted.rms == pytest.approx(chosen.last_third, rel=1e-9)
    assert report.fitted.fitted.rms == pytest.approx(
        extract(CLIP, found.binding).rms_percent, rel=1e-6
    )


@pytest.mark.parametrize("kind", [{}, {"rank": 3}, {"use": "play"}])
def test_threads_do_not_change_a_bit_of_a_choice(kind):
    one, three = (
        Fitter(BINDING, FitSettings(**kind), jobs=jobs).fit([Frames(CLIP)]) for jobs in (1, 3)
    )
    assert one.report.ladder
    np.testing.assert_array_equal(one.binding.weights, three.binding.weights)
    assert one.report == three.report


def test_frames_that_repeat_count_once():
    few = np.concatenate(4 * [CLIP[:20]])
    report = fit(few).report
    assert report.fitted_frames > 20
    assert report.distinct_frames == 20
    assert report.limit is StrengthLimit.FRAMES
    assert report.ladder == ()


def test_a_fit_to_noise_stays_at_the_strongest():
    still = np.repeat(BINDING.rest.vertices[None], 40, axis=0)
    noise = np.random.default_rng(0).normal(size=still.shape)
    report = fit(still + 1e-2 * noise).report
    assert report.regularization == LADDER[0].strength.regularization
    assert report.limit in (StrengthLimit.KEPT_ASIDE, StrengthLimit.GAIN)


def test_without_memory_for_trials_the_default_is_taken():
    m, n = BINDING.weights.shape
    sample = 2 * 40 * 3 * 8 * m
    for trials, limit in ((4 * 8 * m * n, None), (4 * 8 * m * n - 1, StrengthLimit.MEMORY)):
        memory = estimate_memory(m, n, 1) + sample + trials
        report = Fitter(BINDING, FitSettings(), memory=memory).fit([Frames(CLIP[:40])]).report
        assert report.fitted_frames == 40
        assert (report.limit is StrengthLimit.MEMORY) == (limit is StrengthLimit.MEMORY)
        assert bool(report.ladder) == (limit is None)


def test_a_trial_takes_its_last_step_back():
    fitter = Fitter(BINDING, FitSettings())
    sample = fitter.sample([Frames(CLIP)])
    first, second = (fitter.make_alternator(sample, rung.strength) for rung in LADDER[:2])
    trial = Trial(sample, sample.in_held_out_block, first.problem)
    error = trial.advance(first, rounds=2)
    kept = trial.change
    assert trial.advance(second, rounds=2) < error
    assert trial.change is not kept
    trial.go_back()
    assert trial.change is kept


def test_edits_are_measured_relative_to_the_weights_before():
    """Weights twice as rough double the roughness; the same weights have a ratio of one."""
    problem = (
        Fitter(BINDING, FitSettings())
        .make_alternator(Fitter(BINDING).sample([Frames(CLIP)]), DEFAULT_STRENGTH)
        .problem
    )
    meter = EditMeter(problem, BINDING.cage)
    assert meter.measure(Correction.none(*BINDING.weights.shape)) == EditRoughness(1.0, 1.0)
    doubled = meter.measure_weights(2 * problem.rest_weights)
    assert (doubled.smooth, doubled.local) == pytest.approx((2.0, 2.0))
    noise = np.random.default_rng(1).normal(size=BINDING.weights.shape)
    assert meter.measure_weights(problem.rest_weights + 0.1 * noise).largest > 2


def test_weights_are_blended_until_edits_are_smooth_enough():
    fitter = Fitter(BINDING)
    problem = fitter.make_alternator(fitter.sample([Frames(CLIP)]), DEFAULT_STRENGTH).problem
    meter, smooth = EditMeter(problem, BINDING.cage), problem.rest_weights
    noise = np.random.default_rng(1).normal(size=smooth.shape)
    roughness = [meter.measure_weights(smooth + size * noise).largest for size in (0.01, 1.0)]
    assert roughness[0] < MAX_EDIT_ROUGHNESS < roughness[1]
    kept = smooth + 0.01 * noise
    np.testing.assert_array_equal(meter.blend(smooth, kept), kept)
    np.testing.assert_array_equal(meter.blend(smooth, smooth + 100 * noise), smooth)
    sizes = np.geomspace(0.01, 1, 40)
    size = next(s for s in sizes if meter.measure_weights(smooth + s * noise).largest > 1.16)
    blended = meter.blend(smooth, smooth + size * noise)
    assert meter.measure_weights(blended).largest <= MAX_EDIT_ROUGHNESS
    assert np.abs(blended - smooth).max() > 0


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"use": "look"}, "`use=` is 'look', expected one of edit, play"),
        ({"use": "play", "regularization": 0.1}, "the fit is for play, but its regularization"),
    ],
)
def test_uses_that_mean_nothing_are_refused(wrong, named):
    with refused(SettingError, named):
        FitSettings(**wrong)


def test_roughness_below_zero_is_refused():
    with refused(SettingError, "local is -1.0, expected zero or above"):
        EditRoughness(1.0, -1.0)
    assert replace(EditRoughness(1.0, 1.2)).largest == 1.2
