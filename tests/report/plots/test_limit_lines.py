"""Limits in the plot over the frames: lines, labels and their texts."""

from decimal import Decimal

import numpy as np
import pytest

from cageik_cli.report.limits import Limit, LimitCheck
from cageik_cli.report.plots.error_plot import draw_plot
from cageik_cli.report.plots.limit_lines import (
    EDGE_MARGIN,
    LABEL_GAP,
    LABEL_HEIGHT,
    Label,
    format_limit_label,
    place_labels,
)
from cageik_cli.report.vocabulary import EXTRACTION_VOCABULARY
from tests.report.drawings import lines, texts


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
    drawn = draw_plot(make_report([0.0, 2.0, 1.0], [0.0, -1.0, 1.0], limits=limits))
    drawn.draw_without_rendering()
    boxes = [
        text.get_window_extent()
        for text in drawn.axes[0].texts
        if "≤" in text.get_text() or text.get_text().startswith("worst")
    ]
    assert len(boxes) == 8
    axes = drawn.axes[0].get_window_extent()
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
    assert (
        format_limit_label(gate, EXTRACTION_VOCABULARY) == "volume change ≤ 1.1000 %, not checked"
    )


def test_a_typed_limit_keeps_its_digits():
    gate = LimitCheck("max_deviation", "units", 0.12345678, 0.1, "a", True)
    assert (
        format_limit_label(gate, EXTRACTION_VOCABULARY)
        == "max deviation ≤ 0.12345678 units, within limit"
    )


NOTHING = np.empty((0, 2))


def meet(one, other):
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


@pytest.mark.parametrize(
    ("from_right", "left"), [(False, EDGE_MARGIN), (True, 1 - EDGE_MARGIN - 0.3)]
)
def test_a_single_label_is_above_its_line_on_its_own_side(from_right, left):
    (box,) = place_labels([Label(0.3, (0.5,), from_right)], NOTHING, [0.5], [])
    assert box == pytest.approx((left, 0.5 + LABEL_GAP, left + 0.3, 0.5 + LABEL_GAP + LABEL_HEIGHT))


def test_a_label_avoids_curves_lines_and_the_upper_end():
    curve = np.stack([np.linspace(0, 0.5, 100), np.full(100, 0.53)], axis=1)
    (beside,) = place_labels([Label(0.3, (0.5,), False)], curve, [0.5, 0.46], [])
    assert beside[0] >= 0.5
    (below,) = place_labels([Label(0.3, (0.5,), False)], NOTHING, [0.5, 0.53], [])
    assert below[3] == pytest.approx(0.5 - LABEL_GAP)
    (inside,) = place_labels([Label(0.3, (0.99,), False)], NOTHING, [0.99], [])
    assert inside[3] < 0.99


def test_a_label_of_two_lines_is_at_the_free_one():
    (box,) = place_labels([Label(0.9, (0.8, 0.2), False)], NOTHING, [0.8, 0.2], [(0, 0.7, 1, 0.9)])
    assert box[1] == pytest.approx(0.2 + LABEL_GAP)


def test_labels_do_not_overlap():
    labels = [Label(0.3, (0.5 + 0.03 * k,), k % 2 == 1) for k in range(6)]
    boxes = place_labels(labels, NOTHING, [0.5], [(0.0, 0.5, 0.1, 0.6)])
    assert len(boxes) == 6
    assert not any(meet(one, other) for k, one in enumerate(boxes) for other in boxes[:k])
    assert not any(meet(one, (0.0, 0.5, 0.1, 0.6)) for one in boxes)


def test_a_label_wider_than_the_axes_starts_at_the_left():
    (box,) = place_labels([Label(1.5, (0.5,), True)], np.full((3, 2), np.nan), [0.5], [])
    assert box[0] == EDGE_MARGIN
