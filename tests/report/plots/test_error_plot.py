"""The plot over the frames: its curves are the record's metrics; any record can be drawn."""

import io
import re
from dataclasses import replace
from decimal import Decimal
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image

from cageik_cli.report.limits import Limit
from cageik_cli.report.plots.error_plot import render_page_plot, render_plot_png, render_plot_svg
from cageik_cli.report.record import build_report
from tests.report.drawings import drawn, lines, texts

pytestmark = pytest.mark.slow


def test_the_curves_are_the_metrics_of_the_record(report):
    (error,), (change,) = lines(report, "rms"), lines(report, "volume_change")
    frames = report.frames
    np.testing.assert_array_equal(error.get_xydata()[:, 0], range(1, 6))
    np.testing.assert_array_equal(error.get_ydata(), [frame.rms_percent for frame in frames])
    np.testing.assert_array_equal(change.get_ydata(), [frame.volume_change for frame in frames])
    left, right = drawn(report).axes
    assert left.get_ylabel() == "RMS error, % of the diagonal"
    assert right.get_ylabel() == "volume change, %"
    assert left.get_xlabel() == "frame of cages.h5"
    assert error.get_color() != change.get_color()
    assert error.get_linestyle() != change.get_linestyle()
    assert error.get_marker() != change.get_marker()


def test_a_fitted_result_has_both_curves(fitted):
    report = build_report(fitted)
    some = replace(report.unfitted, frames=(0, 5, 11), rms_percent=(0.0, 7.0, 3.0))
    told = replace(report, unfitted=some)
    (error,), (before,) = lines(told, "rms"), lines(told, "unfitted")
    np.testing.assert_array_equal(before.get_xydata(), [[1, 0], [6, 7], [12, 3]])
    assert (error.get_label(), before.get_label()) == ("RMS error, fitted", "mean-value")
    assert error.get_color() != before.get_color()
    assert error.get_linestyle() != before.get_linestyle()
    assert drawn(told).axes[0].get_ylim()[1] > 7
    assert lines(replace(report, unfitted=None), "unfitted") == []


def test_the_worst_frame_is_ringed_and_labelled(report):
    (ring,), (clip,) = lines(report, "worst"), lines(report, "clip")
    summary = report.summary
    place = (1 + summary.worst_frame_index, summary.worst_frame_rms_percent)
    assert tuple(ring.get_xydata()[0]) == pytest.approx(place)
    assert set(clip.get_ydata()) == {summary.rms_percent}
    name = f"worst {summary.worst_frame_rms_percent:.4f} %, {summary.worst_frame}"
    assert name in texts(report)


def test_an_open_model_shows_its_largest_deviations(opened):
    report = build_report(opened.result)
    assert lines(report, "volume_change") == []
    (deviation,) = lines(report, "max_deviation")
    expected = [frame.max_deviation_percent for frame in report.frames]
    np.testing.assert_array_equal(deviation.get_ydata(), expected)
    assert "max deviation, % of the diagonal" in texts(report)


def test_skipped_frames_are_gaps(make_report):
    report = make_report([0.0, 1.0, None, None, 2.0, 1.0], [0.0, -1.0, None, None, 1.0, None])
    (error,) = lines(report, "rms")
    np.testing.assert_array_equal(error.get_ydata(), [0, 1, np.nan, np.nan, 2, 1])
    (shades,) = drawn(report).axes[1].collections
    (box,) = [path.get_extents() for path in shades.get_paths()]
    assert (box.x0, box.x1) == (2.5, 4.5)
    assert "skipped" in texts(report)
    assert "skipped" not in texts(make_report([1.0, 2.0]))


def test_the_axis_has_the_numbers_of_the_frames(make_report):
    report = make_report([0.0, 1.0, None, 3.0], start=1001, frame_step=2)
    (error,), (ring,) = lines(report, "rms"), lines(report, "worst")
    np.testing.assert_array_equal(error.get_xdata(), [1001, 1003, 1005, 1007])
    assert tuple(ring.get_xydata()[0]) == (1007, 3)
    axes = drawn(report).axes
    (box,) = [path.get_extents() for path in axes[1].collections[0].get_paths()]
    assert (box.x0, box.x1) == (1004, 1006)
    assert axes[0].get_xlim() == (1000, 1008)
    _, places = render_page_plot(report)
    assert (places["first"], places["last"]) == (-0.5, 3.5)


def test_many_limits_without_a_line_are_cut_short(make_report):
    limits = [Limit("max_deviation", Decimal(k)) for k in range(90, 99)]
    (text,) = [
        text
        for text in texts(make_report([1.0, 2.0], [0.0, 1.0], limits=limits))
        if text.startswith("limits without a line: ")
    ]
    assert len(text) <= 100
    assert text.endswith(" …")


def test_limits_without_a_line_are_named(make_report):
    far = make_report([1.0, 2.0], [0.0, 1.0], limits=[Limit("rms", Decimal(90))])
    other = make_report([1.0, 2.0], [0.0, 1.0], limits=[Limit("max_deviation", Decimal(90))])
    assert lines(far, "limit") == lines(other, "limit") == []
    assert "limits without a line: rms ≤ 90 %, within limit" in texts(far)
    assert "limits without a line: max deviation ≤ 90 %, within limit" in texts(other)
    (error,) = lines(far, "rms")
    assert error.axes.get_ylim()[1] < 5


CLIPS = {
    "one frame": ([0.5], [0.1]),
    "no error": ([0.0] * 4, [0.0] * 4),
    "one left": ([None, None, 0.3, None], [None, None, 0.1, None]),
    "rounding": ([1e-15, 3e-15, 2e-15], [1e-13, -1e-13, 0.0]),
    "tiny": ([1e-300, 2e-300], [1e-300, -1e-300]),
    "huge": ([1e60, 1e120], [1e307, -1e307]),
    "a peak": ([1e-9, 1e9], [1e-9, -1e9]),
}


@pytest.mark.parametrize(("errors", "changes"), CLIPS.values(), ids=CLIPS)
def test_any_clip_is_drawn(make_report, errors, changes):
    report = make_report(errors, changes)
    assert render_plot_png(report).startswith(b"\x89PNG")
    assert len(texts(report)) > 8
    (marked,) = lines(report, "rms")
    assert marked.get_markevery() == [k for k, error in enumerate(errors) if error is not None]


def test_rounding_does_not_look_like_error(make_report):
    report = make_report([1e-15, 3e-15], [1e-13, -1e-13], limits=[Limit("rms", Decimal("0.3"))])
    for axes in drawn(report).axes:
        assert 0.001 < axes.get_ylim()[1] < 0.002
    assert "limits without a line: rms ≤ 0.3 %, within limit" in texts(report)


@pytest.mark.parametrize("count", [1, 2, 3, 40])
def test_frames_are_numbered_in_whole_numbers(make_report, count):
    axes = drawn(make_report([1.0] * count)).axes[0]
    places = [place for place in axes.get_xticks() if -0.5 <= place <= count - 0.5]
    assert places
    assert places == [round(place) for place in places]


def test_frames_between_gaps_are_marked_in_long_clips(make_report):
    errors = [1.0] * 100
    errors[10] = errors[12] = errors[-2] = None
    assert lines(make_report(errors), "rms")[0].get_markevery() == [11, 99]


@pytest.mark.parametrize("name", ["x" * 300, "$a_{}$ <&> \"'", "\x01\x7f\n{}", "動き{}", "{}%\\"])
def test_any_name_is_shown(make_report, name):
    report = replace(make_report([1.0, 2.0], names=name), result=name)
    render_plot_png(report)
    (shown,) = [text for text in texts(report) if text.startswith("worst ")]
    assert len(shown) < 60
    if name.startswith("$"):
        assert shown == "worst 2.0000 %, $a_1$ <&> \"'"


def test_a_long_clip_is_small(make_report):
    values = np.random.default_rng(1).random((2, 2000))
    assert len(render_page_plot(make_report(values[0].tolist(), values[1].tolist()))[0]) < 300_000


def test_the_same_report_gives_the_same_bytes_whatever_the_settings(report):
    png, svg = render_plot_png(report), render_plot_svg(report)
    with mpl.rc_context({"font.size": 30, "lines.linewidth": 9, "svg.fonttype": "path"}):
        assert (render_plot_png(report), render_plot_svg(report)) == (png, svg)
    image = Image.open(io.BytesIO(png))
    assert image.size == (1440, 720)
    assert set(image.info) <= {"dpi"}
    assert "date" not in svg


def test_the_page_plot_has_the_position_of_the_axes(report):
    svg, places = render_page_plot(report)
    root = ElementTree.fromstring(svg)
    assert svg.startswith("<svg ")
    assert {"width", "height"}.isdisjoint(root.attrib)
    _, _, width, height = map(float, root.attrib["viewBox"].split())
    axes = drawn(report).axes[0]
    assert axes.get_xlim() == (1 + places["first"], 1 + places["last"])
    # The first path of the axes is their background.
    place = re.search(r'id="axes_1".*? d="(.*?)"', svg, re.DOTALL)[1]
    x, y = np.array(re.findall(r"[ML] ([\d.]+) ([\d.]+)", place), float).T
    assert x.min() / width == pytest.approx(places["left"])
    assert x.max() / width == pytest.approx(places["right"])
    assert y.min() / height == pytest.approx(places["top"])
    assert y.max() / height == pytest.approx(places["bottom"])
