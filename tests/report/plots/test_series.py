"""What is drawn over the frames: the record's figures, gaps, and nothing beyond any axis."""

import numpy as np
import pytest

from cageik_cli.report.plots.series import MAX_PLOTTED_PERCENT, build_series
from cageik_cli.report.record import build_report


def test_a_closed_model_has_changes_of_volume(made):
    error, change = build_series(made([1.0, None, 2.0], [0.5, None, -0.5]))
    np.testing.assert_array_equal(error.values, [1, np.nan, 2])
    np.testing.assert_array_equal(change.values, [0.5, np.nan, -0.5])
    assert change.is_signed
    assert not error.is_signed
    assert (error.side, change.side) == (0, 1)


def test_where_no_frame_has_a_volume_it_is_the_largest_deviation(made, opened):
    _, deviation = build_series(made([1.0, None, 2.0]))
    np.testing.assert_array_equal(deviation.values, [3, np.nan, 6])
    assert (
        deviation.metrics
        == build_series(build_report(opened.result))[1].metrics
        == ("max_deviation",)
    )
    assert not deviation.is_signed


@pytest.mark.parametrize("sign", [-1, 1])
def test_lines_leave_the_picture_where_no_axis_could_be_drawn(made, sign):
    _, change = build_series(made([1.0, 2.0], [sign * 1e307, 1.0]))
    np.testing.assert_array_equal(change.values, [sign * MAX_PLOTTED_PERCENT, 1])
