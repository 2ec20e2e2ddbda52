"""The word on a result, and the one step that is advised."""

from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.method.solve.regions import Cause
from cageik_cli.report.notes import (
    MAX_FAIR_DEVIATION,
    MAX_FAIR_RMS,
    MAX_GOOD_DEVIATION,
    MAX_GOOD_RMS,
    judge_quality,
    suggest_step,
)
from cageik_cli.report.record import build_report
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


def test_a_fit_is_advised_where_there_is_none(closed):
    assert suggest_step(closed.result, 1.0, 5.0) == FIT


def test_a_built_cage_is_advised_where_the_given_one_is_far_too_loose(closed):
    (region, *_) = closed.result.regions
    loose = replace(closed.result, regions=(replace(region, cause=Cause.LOOSE_CAGE),))
    assert "without `cage=`" in str(suggest_step(loose, 1.0, 5.0))
    built = replace(loose, settings={**loose.settings, "cage_vertices": 8})
    assert suggest_step(built, 1.0, 5.0) == FIT


@pytest.mark.parametrize(
    ("period", "step"),
    [(1.0, "extract again with `smooth=auto` `overwrite=True`"), ("auto", None)],
)
def test_less_smoothing_is_advised_where_it_is_to_blame(closed, period, step):
    (region, *_) = closed.result.regions
    settings = closed.result.settings | {"smooth": period}
    regions = (replace(region, cause=Cause.SMOOTHING),)
    smoothed = replace(closed.result, regions=regions, settings=settings)
    assert suggest_step(smoothed, 1.0, 5.0) == step


def test_nothing_is_advised_for_an_error_that_is_not_seen(closed):
    assert suggest_step(closed.result, 0.4 * MAX_GOOD_RMS, 0.4 * MAX_GOOD_DEVIATION) is None


def test_after_a_fit_more_vertices_are_advised_if_the_model_has_data_for_them(fitted):
    assert suggest_step(fitted, 1.0, 5.0) is None  # 66 vertices for a cage of 36
    count = len(fitted.cage.vertices)
    dense = ball(3, 1.0)
    small = replace(fitted, rest=dense, vertex_rms=np.ones(len(dense.vertices)))
    assert suggest_step(small, 1.0, 5.0) == (
        f"extract again with `vertices={2 * count}` `overwrite=True`, without `cage=`"
    )
    bound = replace(small, sources={**small.sources, "binding": {}})
    assert str(suggest_step(bound, 1.0, 5.0)).endswith("`overwrite=True`, without `binding=`")
    built = replace(small, settings={**small.settings, "cage_vertices": count})
    assert suggest_step(built, 1.0, 5.0) == (
        f"extract again with `vertices={2 * count}` `overwrite=True`"
    )


def test_another_rest_pose_is_advised_where_limbs_share_a_loop(fitted, closed):
    (region, *_) = closed.result.regions
    shared = replace(fitted, regions=(replace(region, cause=Cause.SHARED_LOOP),))
    built = {**shared.settings, "rest_frame": 0, "cage_vertices": 36}
    first = replace(shared, settings=built)
    assert "`rest_frame=auto`" in str(suggest_step(first, 1.0, 5.0))
    given = replace(shared, settings={**shared.settings, "rest_frame": 0})
    assert suggest_step(given, 1.0, 5.0) is None  # another rest pose is not in that cage
    chosen = replace(shared, settings={**built, "rest_frame": None})
    assert suggest_step(chosen, 1.0, 5.0) is None


def test_a_fit_is_advised_only_where_extraction_takes_one(closed, monkeypatch):
    bound = replace(closed.result, sources={**closed.result.sources, "binding": {}})
    assert suggest_step(bound, 1.0, 5.0) == (
        "bind again with `fit=FRAMES`, then extract with that `binding=`"
    )
    short = replace(closed.result, frames=closed.result.frames[:2], skipped={})
    for result in (short, replace(closed.result, kept=object())):
        assert "fit" not in (suggest_step(result, 1.0, 5.0) or "")
    monkeypatch.setattr("cageik_cli.report.notes.has_weights", lambda _: False)
    assert "fit" not in (suggest_step(closed.result, 1.0, 5.0) or "")


def test_outliers_are_not_rejected_twice(closed, monkeypatch):
    monkeypatch.setattr("cageik_cli.report.notes.has_outliers", lambda _: True)
    assert "`robust=True`" in str(suggest_step(closed.result, 1.0, 5.0))
    robust = replace(closed.result, settings={**closed.result.settings, "robust": True})
    assert "`robust=True`" not in str(suggest_step(robust, 1.0, 5.0))


def test_warnings_come_first_then_notes_on_the_result_then_those_on_files(closed):
    """What hides on the first page is what changes least."""
    unit, inward = Note("no file states its unit"), Note("the faces turn inward", "warning")
    noted = replace(closed.result, notes=(unit, inward), regions=None)
    found = build_report(noted).notes
    assert (found[0], found[-1]) == (inward, unit)
    assert len(found) > 2
