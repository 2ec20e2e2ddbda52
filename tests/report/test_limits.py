"""Metrics are compared as printed, with typed limits and with a baseline."""

import json
from dataclasses import asdict, replace
from decimal import Decimal
from pathlib import Path

import pytest

from cageik_cli.report.figures import ReportSummary, format_length, format_percent
from cageik_cli.report.limits import (
    FILE_UNITS,
    METRICS,
    PERCENT,
    Baseline,
    Limit,
    Limits,
    check_limits,
    find_frames_digest,
    find_gaps,
    list_baseline_notes,
)
from cageik_cli.report.record import build_report
from cageik_cli.report.views.text import format_check_row
from cageik_cli.report.vocabulary import EXTRACTION_VOCABULARY
from tests.report.clips import percent_metrics, summary

FIELDS = {
    ("rms", PERCENT): "rms_percent",
    ("rms", FILE_UNITS): "rms",
    ("frame_rms", PERCENT): "worst_frame_rms_percent",
    ("frame_rms", FILE_UNITS): "worst_frame_rms",
    ("max_deviation", PERCENT): "max_deviation_percent",
    ("max_deviation", FILE_UNITS): "max_deviation",
    ("volume_change", PERCENT): "volume_change_percent_max",
}
FRAMES = {"rms": "f_7.obj", "frame_rms": "f_7.obj", "max_deviation": "f_8.obj",
          "volume_change": "f_9.obj"}  # fmt: skip


def check_one(figures: ReportSummary, metric: str, most: str, unit: str = PERCENT):
    (found,) = check_limits("a", figures, Limits((Limit(metric, Decimal(most), unit),)))
    return found


@pytest.mark.parametrize(("metric", "unit"), FIELDS)
@pytest.mark.parametrize("sign", [1, -1])
def test_a_metric_is_compared_as_printed(metric, unit, sign):
    """Values are compared after rounding as printed, changes without their sign."""
    name = FIELDS[metric, unit]
    sign = sign if metric == "volume_change" else 1
    printed = "0.1235" if unit == PERCENT else "0.123457"
    step = "0.0001" if unit == PERCENT else "0.000001"
    for value in (0.12346, 0.12354) if unit == PERCENT else (0.1234566, 0.1234574):
        figures = summary(**{"rms_percent": 1.0, name: sign * value})
        for most, passes in (
            (printed, True),
            (str(Decimal(printed) + Decimal(step)), True),
            (str(Decimal(printed) - Decimal(step)), False),
            (printed + "0000001", True),
            (str(Decimal(printed) - Decimal("1e-12")), False),
        ):
            gate = check_one(figures, metric, most, unit)
            assert gate.passed is passes
            assert (gate.found, gate.limit) == (float(printed), float(most))
            assert (gate.metric, gate.unit, gate.frame) == (metric, unit, FRAMES[metric])
            assert gate.baseline is None


def test_a_limit_of_zero_accepts_what_may_be_rounding():
    assert check_one(summary(0.00004), "rms", "0").passed is True
    assert check_one(summary(0.00006), "rms", "0").passed is False


def test_a_metric_that_is_not_defined_is_not_checked():
    opened = summary(volume_change_percent_max=None, volume_change_frame=None)
    gate = check_one(opened, "volume_change", "2")
    assert (gate.found, gate.frame, gate.passed) == (None, None, None)
    assert format_check_row(gate, EXTRACTION_VOCABULARY) == (
        "not checked",
        "volume change not defined, limit 2 %",
    )


def test_lines_name_metric_value_limit_and_frame():
    assert format_check_row(check_one(summary(0.25), "rms", "0.5"), EXTRACTION_VOCABULARY) == (
        "within limit", "rms 0.2500 %, limit 0.5 %, worst frame f_7.obj",
    )  # fmt: skip
    over = check_one(summary(), "max_deviation", "0.0199", FILE_UNITS)
    assert format_check_row(over, EXTRACTION_VOCABULARY) == (
        "over limit", "max deviation 0.02 units, limit 0.0199 units, at f_8.obj",
    )  # fmt: skip
    limits = Limits((), baseline({"a": percent_metrics(summary(0.2))}, "10"))
    assert format_check_row(check_limits("a", summary(0.25), limits)[0], EXTRACTION_VOCABULARY) == (
        "over limit", "rms 0.2500 %, limit 0.2200 % (baseline 0.2000 %), worst frame f_7.obj",
    )  # fmt: skip


def baseline(figures, regression) -> Baseline:
    return Baseline(Path("old.json"), figures, Decimal(regression))


@pytest.mark.parametrize("regression", ["0", "0.01", "10", "1e300"])
@pytest.mark.parametrize("value", [0.0, 0.00004, 0.12345, 0.12355, 2 / 3, 99.99995, 1e9, 1e300])
def test_unchanged_metrics_pass(value, regression):
    """Also when the float is above the printed value."""
    figures = summary(value)
    limits = Limits((), baseline({"a": percent_metrics(figures)}, regression))
    found = check_limits("a", figures, limits)
    assert [gate.metric for gate in found] == list(METRICS)
    assert all(gate.passed for gate in found)
    assert found[0].baseline == float(format_percent(value))
    json.dumps([asdict(gate) for gate in found], allow_nan=False)


@pytest.mark.parametrize(
    ("old", "regression", "most"),
    [
        (0.2527, "0", "0.2527"),
        (0.2527, "10", "0.2779"),  # 0.27797
        (0.2527, "0.1", "0.2529"),  # 0.2529527
        (0.2527, "0.01", "0.2527"),
        (0.25274, "0", "0.2527"),
        (0.25266, "100", "0.5054"),
        (0.0, "50", "0.0000"),
    ],
)
def test_the_limit_of_a_baseline_is_rounded_down(old, regression, most):
    limits = Limits((), baseline({"a": percent_metrics(summary(old))}, regression))
    for value, passes in ((Decimal(most), True), (Decimal(most) + Decimal("0.0001"), False)):
        gate = check_limits("a", summary(float(value)), limits)[0]
        assert (gate.limit, gate.passed) == (float(most), passes)


@pytest.mark.parametrize("metric", METRICS)
def test_every_metric_is_compared(metric):
    old = percent_metrics(summary())
    limits = Limits((), baseline({"a": {**old, metric: old[metric] / 2}}, "10"))
    over = [gate.metric for gate in check_limits("a", summary(), limits) if not gate.passed]
    assert over == [metric]


@pytest.mark.parametrize(
    ("name", "digest", "earlier"),
    [
        ("a", "1", "a"), ("a", "2", "a"), ("a", None, "a"), ("c", "1", "a"), ("c", None, None),
        ("c", "3", None), ("x/b", "2", "b"), ("x/y.h5", "2", "y"), ("z", "2", "b"),
    ],
)  # fmt: skip
def test_a_result_is_known_by_its_name_or_by_its_frames(name, digest, earlier):
    figures = dict.fromkeys(("a", "b", "y"), percent_metrics(summary()))
    old = replace(baseline(figures, "0"), digests={"a": "1", "b": "2", "y": "2"})
    limits = Limits((), old)
    assert limits.find_counterpart(name, digest) == earlier
    assert len(check_limits(earlier, summary(), limits)) == (0 if earlier is None else 4)
    several = limits.match_several([name, "b"])
    expected = {"b": name if name == "b" else "y"}.get(earlier, earlier)
    assert several.find_counterpart(name, digest) == expected
    notes = list_baseline_notes(name, digest, summary(), limits)
    says = {None: "has no such clip", name: "differ"}.get(earlier, f"those of {earlier} in old")
    is_same = earlier == name and digest in (None, old.digests[name])
    assert notes == () if is_same else says in notes[0]


def test_without_a_baseline_nothing_is_compared_and_nothing_lacks():
    assert Limits().match_several(["a"]) == Limits()
    assert Limits().find_counterpart("a", "1") is None
    assert list_baseline_notes("a", "1", summary(), Limits()) == ()
    assert find_gaps(["a"], {"a": Limits()}, {"a": None}) == ()


@pytest.mark.parametrize("edited_from", [None, "walk.h5"])
@pytest.mark.parametrize(
    ("sources", "digest"),
    [
        ({"frames": {"name": "a.h5::run", "sha256": "1f"}}, "1f::run"),
        ({"frames": {"name": "a.obj ... b.obj", "sha256": "1f"}}, "1f"),
        ({"frames": {"name": "a"}}, None), ({"frames": {"sha256": "1f"}}, None),
        ({"frames": 3}, None), ({}, None),
    ],
)  # fmt: skip
def test_clips_of_one_file_differ_and_an_edit_is_no_clip(sources, digest, edited_from):
    found = find_frames_digest(sources, edited_from)
    assert found == (digest if edited_from is None else None)


def test_a_volume_that_only_one_run_has_is_not_checked():
    opened = summary(volume_change_percent_max=None, volume_change_frame=None)
    now_open = Limits((), baseline({"a": percent_metrics(summary())}, "10"))
    gate = check_limits("a", opened, now_open)[-1]
    assert (gate.metric, gate.found, gate.passed) == ("volume_change", None, None)
    now_closed = Limits((), baseline({"a": percent_metrics(opened)}, "10"))
    assert [gate.metric for gate in check_limits("a", summary(), now_closed)] == list(METRICS[:3])
    assert list_baseline_notes("a", None, summary(), known(now_closed)) == (
        "volume change not compared with the baseline: not defined in old.json",
    )
    assert list_baseline_notes("a", None, opened, known(now_closed)) == ()


def known(limits: Limits) -> Limits:
    """The limits with a digest in their baseline."""
    return replace(limits, baseline=replace(limits.baseline, digests={"a": "1"}))


def test_typed_limits_come_first(closed):
    digest = find_frames_digest(closed.result.sources, None)
    figures = build_report(closed.result).summary
    limits = Limits(
        (Limit("rms", Decimal(format_length(figures.rms)), FILE_UNITS),),
        replace(
            baseline({"cages.h5": percent_metrics(figures)}, "0"), digests={"cages.h5": digest}
        ),
    )
    report = build_report(closed.result, limits)
    assert [gate.baseline is None for gate in report.gates] == [True, False, False, False, False]
    assert all(gate.passed for gate in report.gates)
    assert report.notes == closed.result.notes
