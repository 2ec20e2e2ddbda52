"""The curves over the frames: the record's metrics, with gaps, and their limits."""

from decimal import Decimal

import numpy as np
import pytest

from cageik_cli.report.limits import Limit, LimitCheck
from cageik_cli.report.plots.error_plot import build_series, label_limit
from cageik_cli.report.record import build_report
from cageik_cli.report.vocabulary import EXTRACTION_VOCABULARY
from tests.report.drawings import drawn, lines, texts


def test_a_closed_model_shows_its_volume_changes(make_report):
    error, change = build_series(make_report([1.0, None, 2.0], [0.5, None, -0.5]))
    np.testing.assert_array_equal(error.values, [1, np.nan, 2])
    np.testing.assert_array_equal(change.values, [0.5, np.nan, -0.5])
    assert change.is_signed
    assert not error.is_signed
    assert (error.metric, change.metric) == ("rms", "volume_change")


def test_without_volumes_the_largest_deviation_is_shown(make_report, opened):
    _, deviation = build_series(make_report([1.0, None, 2.0]))
    np.testing.assert_array_equal(deviation.values, [3, np.nan, 6])
    assert deviation.metric == "max_deviation"
    assert build_series(build_report(opened.result))[1].metric == "max_deviation"
    assert not deviation.is_signed


@pytest.mark.parametrize("sign", [-1, 1])
def test_huge_values_are_clamped(make_report, sign):
    _, change = build_series(make_report([1.0, 2.0], [sign * 1e307, 1.0]))
    np.testing.assert_array_equal(change.values, [sign * 1e150, 1])


def test_limits_are_dashed_lines_with_labels(make_report):
    typed = (("rms", "1.5", "%"), ("frame_rms", "1.9", "%"), ("volume_change", "2", "%"))
    report = make_report(
        [0.0, 2.0], [0.0, -1.0], limits=[Limit(m, Decimal(v), u) for m, v, u in typed]
    )
    drawn = lines(report, "limit")
    assert sorted(line.get_ydata()[0] for line in drawn) == [-2, 1.5, 1.9, 2]
    assert all(line.is_dashed() for line in drawn)
    assert {"rms ≤ 1.5 %, within limit", "frame rms ≤ 1.9 %, over limit"} <= set(texts(report))


def test_labels_of_close_limits_do_not_overlap(make_report):
    """They also stay in the axes and off the label of the worst frame."""
    typed = [("rms", 1.5), ("rms", 1.52), ("frame_rms", 1.9), ("frame_rms", 1.93)]
    typed += [("volume_change", 0.9), ("volume_change", 0.92), ("frame_rms", 2.2)]
    limits = [Limit(metric, Decimal(str(most))) for metric, most in typed]
    figure = drawn(make_report([0.0, 2.0, 1.0], [0.0, -1.0, 1.0], limits=limits))
    figure.draw_without_rendering()
    boxes = [
        text.get_window_extent()
        for text in figure.axes[0].texts
        if "≤" in text.get_text() or text.get_text().startswith("worst")
    ]
    assert len(boxes) == 8
    axes = figure.axes[0].get_window_extent()
    for k, box in enumerate(boxes):
        assert axes.x0 <= box.x0 < box.x1 <= axes.x1
        assert axes.y0 <= box.y0 < box.y1 <= axes.y1
        assert not any(box.overlaps(other) for other in boxes[:k])


def test_a_limit_in_file_units_is_converted_by_the_diagonal(make_report):
    report = make_report([0.0, 2.0], limits=[Limit("frame_rms", Decimal("0.02"), "units")])
    (line,) = lines(report, "limit")
    assert line.get_ydata()[0] == pytest.approx(100 * 0.02 / report.clip.diagonal)
    assert any(text.startswith("frame rms ≤ 0.02 units, ") for text in texts(report))


def test_a_limit_of_a_baseline_is_printed_with_four_decimals():
    gate = LimitCheck("volume_change", "%", 1.1, None, None, None, baseline=1.0)
    assert label_limit(gate, EXTRACTION_VOCABULARY) == "volume change ≤ 1.1000 %, not checked"


def test_a_typed_limit_keeps_its_digits():
    gate = LimitCheck("max_deviation", "units", 0.12345678, 0.1, "a", True)
    assert (
        label_limit(gate, EXTRACTION_VOCABULARY) == "max deviation ≤ 0.12345678 units, within limit"
    )
