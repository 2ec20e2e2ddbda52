"""The word on a result, and the one step that is advised."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from cageik_cli.method.solve.regions import Cause
from cageik_cli.report.figures import KeptSummary
from cageik_cli.report.html.page import render_page
from cageik_cli.report.notes import (
    MAX_FAIR_DEVIATION,
    MAX_FAIR_RMS,
    MAX_GOOD_DEVIATION,
    MAX_GOOD_RMS,
    Advice,
    judge_quality,
    suggest_step,
)
from cageik_cli.report.record import build_report, judge_errors
from cageik_cli.report.views.front import describe_doubt, list_verdict_rows
from cageik_cli.store.tried_steps import HiddenErrors, Step, TriedStep
from cageik_cli.util.messages import Note
from tests.shapes import ball

FIT = "extract again with `fit=True` `overwrite=True`"


@pytest.mark.parametrize(
    ("rms", "deviation", "word"),
    [
        (MAX_GOOD_RMS, MAX_GOOD_DEVIATION, "good"),
        (MAX_GOOD_RMS + 0.01, MAX_GOOD_DEVIATION, "fair"),
        (MAX_GOOD_RMS + 0.004, MAX_GOOD_DEVIATION + 0.04, "good"),  # shown as 0.30 and 3.0
        (MAX_FAIR_RMS + 0.004, MAX_FAIR_DEVIATION + 0.04, "fair"),
        (MAX_GOOD_RMS, MAX_GOOD_DEVIATION + 0.1, "fair"),
        (MAX_FAIR_RMS, MAX_FAIR_DEVIATION, "fair"),
        (MAX_FAIR_RMS + 0.01, 0.0, "poor"),
        (0.0, MAX_FAIR_DEVIATION + 0.1, "poor"),
        (float("nan"), 0.0, "poor"),
    ],
)
def test_the_worse_of_both_errors_decides(rms, deviation, word):
    assert judge_quality(rms, deviation) == word


def test_an_edit_has_no_quality_and_no_advice(edited):
    report = build_report(edited)
    assert (report.quality, report.better) == (None, None)


def try_step(result, step, after=0.5, **changes):
    """The result of a run in which a step left `after` percent of the 1 % before."""
    return replace(result, tried=(TriedStep(step, 1.0, after, 12),), **changes)


def test_a_fit_is_advised_where_it_was_tried_and_helped(closed):
    for after, is_advised in ((0.5, True), (0.99, False), (1.5, False)):
        found = suggest_step(try_step(closed.result, Step.FIT, after), 1.0, 5.0)
        assert (found is not None) == is_advised
    tried = try_step(closed.result, Step.FIT)
    assert suggest_step(tried, 1.0, 5.0) == Advice(FIT, tried.tried[0])
    bound = replace(tried, sources={**tried.sources, "binding": {}})
    assert suggest_step(bound, 1.0, 5.0).step == (
        "bind again with `fit=FRAMES`, then extract with that `binding=`"
    )


def test_nothing_is_advised_that_was_not_tried_and_may_hurt(closed):
    assert suggest_step(replace(closed.result, tried=()), 5.0, 20.0) is None


def test_of_two_steps_the_one_that_gains_more_is_advised(closed):
    steps = (TriedStep(Step.ROBUST, 1.0, 0.6, 24), TriedStep(Step.FIT, 0.8, 0.5, 12))
    found = suggest_step(replace(closed.result, tried=steps), 1.0, 5.0)
    assert found == Advice("extract again with `robust=True` `overwrite=True`", steps[0])
    found = suggest_step(replace(closed.result, tried=(steps[1],)), 1.0, 5.0)
    assert found == Advice(FIT, steps[1])


@pytest.fixture
def smooth(monkeypatch):
    """Errors of a result that are alike in neighbours."""
    monkeypatch.setattr("cageik_cli.report.notes._has_smooth_errors", lambda _: True)


def test_a_built_cage_is_advised_where_the_given_one_is_far_too_loose(closed, smooth):
    (region, *_) = closed.result.regions
    tried = try_step(closed.result, Step.FIT)
    loose = replace(tried, regions=(replace(region, cause=Cause.LOOSE_CAGE),))
    step = suggest_step(loose, 1.0, 5.0).step
    assert step == "extract again with `overwrite=True`, without `cage=`: a tighter cage is built"
    built = replace(loose, settings={**loose.settings, "cage_vertices": 8})
    assert suggest_step(built, 1.0, 5.0).step == FIT
    noisy = try_step(loose, Step.ROBUST)  # weights are not fitted to outliers by default
    assert "robust" in str(suggest_step(noisy, 1.0, 5.0).step)
    assert suggest_step(replace(loose, tried=()), 1.0, 5.0) is None


def test_nothing_is_advised_for_an_error_that_is_not_seen(closed):
    tried = try_step(closed.result, Step.FIT)
    assert suggest_step(tried, 0.4 * MAX_GOOD_RMS, 0.4 * MAX_GOOD_DEVIATION) is None


def test_after_a_fit_more_vertices_are_advised_if_the_model_has_data_for_them(fitted, smooth):
    assert suggest_step(fitted, 1.0, 5.0) is None  # 66 vertices for a cage of 36
    count = len(fitted.cage.vertices)
    dense = ball(3, 1.0)
    small = replace(fitted, rest=dense, vertex_rms=np.ones(len(dense.vertices)))
    assert suggest_step(small, 1.0, 5.0).step == (
        f"extract again with `vertices={2 * count}` `overwrite=True`, without `cage=`"
    )
    bound = replace(small, sources={**small.sources, "binding": {}})
    assert str(suggest_step(bound, 1.0, 5.0).step).endswith("`overwrite=True`, without `binding=`")
    built = replace(small, settings={**small.settings, "cage_vertices": count})
    assert suggest_step(built, 1.0, 5.0) == Advice(
        f"extract again with `vertices={2 * count}` `overwrite=True`"
    )
    noisy = try_step(built, Step.ROBUST, after=2.0)
    assert suggest_step(noisy, 1.0, 5.0) is None


@pytest.fixture
def rough_errors(fitted, monkeypatch):
    """Replaces the errors of the result by smooth ones, noise, or what is between."""
    monkeypatch.setattr("cageik_cli.report.notes.MIN_DATA_PER_CAGE_VERTEX", 0.5)
    points = fitted.rest.vertices
    noise = np.random.default_rng(4).normal(size=(3, *points.shape))

    def replace_errors(rough):
        errors = (1 - rough) * points + rough * noise
        frames = SimpleNamespace(errors=errors)
        monkeypatch.setattr("cageik_cli.report.notes.read_key_frames", lambda *_: frames)

    return replace_errors


@pytest.mark.parametrize(("rough", "is_advised"), [(0.0, True), (1.0, False)])
def test_more_vertices_are_not_advised_against_noise(fitted, rough_errors, rough, is_advised):
    """Errors of noise differ from vertex to vertex; those of a smooth cage do not."""
    rough_errors(rough)
    assert (suggest_step(fitted, 1.0, 5.0) is not None) == is_advised


def test_missing_data_or_lost_weights_leave_no_errors_to_judge_by(
    fitted, rough_errors, monkeypatch
):
    rough_errors(0.0)
    assert suggest_step(fitted, 1.0, 5.0) is not None
    assert suggest_step(replace(fitted, kept=object()), 1.0, 5.0) is None
    monkeypatch.setattr("cageik_cli.report.notes.read_binding", lambda _: None)
    assert suggest_step(fitted, 1.0, 5.0) is None


def test_the_gain_is_said_and_in_the_record(closed):
    report = build_report(try_step(closed.result, Step.FIT))
    assert report.gain == TriedStep(Step.FIT, 1.0, 0.5, 12)
    (text,) = [text for label, text in list_verdict_rows(report) if label == "better"]
    assert text == f"{FIT} (1.0 % to 0.50 % on 12 frames)"
    assert (report.better, report.gain.frames) == (FIT, 12)


def test_warnings_come_first_then_notes_on_the_result_then_those_on_files(closed):
    """What hides on the first page is what changes least."""
    unit, inward = Note("no file states its unit"), Note("the faces turn inward", "warning")
    noted = replace(closed.result, notes=(unit, inward), regions=None)
    found = build_report(noted).notes
    assert (found[0], found[-1]) == (inward, unit)
    assert len(found) > 2


def make_kept(missing, rms=0.1, largest=1.0, rejected=0.0):
    return KeptSummary(rms, largest, missing, 1, "a", rejected, 0, "a")


def judge(closed, everything, kept, hidden=None, *, is_torn=False):
    rms, largest = everything
    summary = build_report(closed.result).summary
    summary = replace(summary, rms_percent=rms, max_deviation_percent=largest)
    return judge_quality(*judge_errors(summary, kept, hidden, is_torn=is_torn))


@pytest.mark.parametrize(
    ("missing", "hidden", "word"),
    [
        (0.5, None, "good"),
        (20.0, None, "fair"),  # nobody knows
        (20.0, HiddenErrors(0.2, 2.0, 9), "good"),
        (20.0, HiddenErrors(0.2, 4.0, 9), "fair"),
        (20.0, HiddenErrors(1.0, 2.0, 9), "fair"),
        (20.0, HiddenErrors(3.0, 5.0, 9), "poor"),
    ],
)
def test_what_is_missing_counts_in_the_word_as_what_was_hidden(closed, missing, hidden, word):
    assert judge(closed, (0.1, 1.0), make_kept(missing), hidden) == word


def test_the_word_on_a_torn_input_is_fair_at_best(closed):
    """Its error says how close the torn input is followed."""
    assert judge(closed, (0.1, 1.0), None) == "good"
    assert judge(closed, (0.1, 1.0), None, is_torn=True) == "fair"
    assert judge(closed, (1.1, 1.0), None, is_torn=True) == "poor"
    tried = (TriedStep(Step.TORN, 0.2, 0.1, 8),)
    torn = build_report(replace(closed.result, tried=tried))
    assert any("pieces of the input jump" in note.text for note in torn.notes)
    unhelped = replace(closed.result, tried=(TriedStep(Step.TORN, 0.2, 0.2, 8),))
    assert any("mend the input" in note.text for note in build_report(unhelped).notes)


@pytest.mark.parametrize(
    ("everything", "kept", "word"),
    [
        ((0.2, 2.0), (0.1, 1.0), "good"),
        ((0.2, 4.0), (0.1, 1.0), "fair"),  # one limb that the cage does not follow
        ((3.0, 50.0), (0.1, 1.0), "fair"),  # vertices that were thrown
        ((0.6, 12.0), (0.4, 4.0), "fair"),
        ((3.0, 50.0), (0.4, 8.0), "poor"),
    ],
)
def test_rejected_data_makes_a_result_fair_at_best_where_it_would_change_the_word(
    closed, everything, kept, word
):
    assert judge(closed, everything, make_kept(0.0, *kept, rejected=1.0)) == word
    hidden = HiddenErrors(0.1, 1.0, 9)
    assert judge(closed, everything, make_kept(20.0, *kept, rejected=1.0), hidden) == word


def test_little_that_is_kept_does_not_hide_what_was_rejected(closed):
    """However much is missing, and however well what was hidden is met."""
    kept = make_kept(95.0, 0.1, 1.0, rejected=1.0)
    assert judge(closed, (3.0, 50.0), kept, HiddenErrors(0.01, 0.1, 9)) == "fair"


def test_a_result_is_judged_by_all_data_if_none_was_rejected(closed):
    assert judge(closed, (0.2, 2.0), None) == "good"
    assert judge(closed, (0.2, 8.0), None) == "poor"


@pytest.mark.parametrize(
    ("kept", "everything", "reason"),
    [
        (make_kept(0.0, rejected=1.0), (3.0, 50.0), "all data is off by 3.0 %, at most 50 %"),
        (make_kept(2.0, rejected=1.0), (3.0, 50.0), "all data is off by 3.0 %, at most 50 %"),
        (make_kept(20.0), (0.1, 1.0), "the error of missing vertices is unknown"),
        (make_kept(0.5), (0.1, 1.0), None),  # good
        (make_kept(20.0, 0.5), (0.5, 1.0), None),  # fair without that
        (make_kept(0.0, 0.1, 4.0, rejected=1.0), (3.0, 50.0), None),
        (make_kept(0.0, 0.1, 8.0, rejected=1.0), (3.0, 50.0), None),  # poor
    ],
)
def test_a_result_of_good_figures_says_why_it_is_only_fair(closed, kept, everything, reason):
    summary = build_report(closed.result).summary
    rms, largest = everything
    summary = replace(summary, rms_percent=rms, max_deviation_percent=largest)
    report = replace(
        build_report(closed.result),
        summary=summary,
        kept=kept,
        quality=judge_quality(*judge_errors(summary, kept, None)),
        frames=tuple(
            replace(frame, rms_kept_percent=0.1, max_deviation_kept_percent=1.0)
            for frame in build_report(closed.result).frames
        ),
    )
    (data,) = [text for label, text in list_verdict_rows(report) if label == "data"]
    expected = "" if reason is None else f"{reason}, so fair at best"
    assert describe_doubt(report) == expected
    assert data.endswith(f"; {expected}" if expected else "here")
    assert data in render_page(report)


def test_the_error_of_hidden_data_is_said(closed):
    report = build_report(closed.result)
    report = replace(report, kept=make_kept(20.0), hidden=HiddenErrors(0.5, 2.0, 9))
    frames = tuple(
        replace(frame, rms_kept_percent=0.1, max_deviation_kept_percent=1.0)
        for frame in report.frames
    )
    (text,) = [
        text for label, text in list_verdict_rows(replace(report, frames=frames)) if label == "data"
    ]
    assert text.startswith("20 % of the vertices are missing")
    assert text.endswith("(others, hidden on purpose, are off by 0.50 %)")


def test_smoothing_is_advised_first_and_however_small_the_visible_error(closed):
    tried = try_step(closed.result, Step.SMOOTH)
    step = "extract again with `smooth=auto` `overwrite=True`"
    assert suggest_step(tried, 0.0, 0.0) == Advice(step, tried.tried[0])
    assert suggest_step(try_step(closed.result, Step.SMOOTH, after=0.9), 1.0, 5.0) is None
