"""The curves over the frames: the record's metrics, with gaps, and huge values clamped."""

import numpy as np
import pytest

from cageik_cli.report.plots.series import build_series
from cageik_cli.report.record import build_report


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
