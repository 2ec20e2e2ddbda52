"""Figures of a sample stand for all frames of its clips."""

import numpy as np
import pytest

from cageik_cli.solver.fitting.alternate import find_weighted_percentile


@pytest.mark.parametrize("percent", [1, 50, 99, 100])
def test_a_percentile_counts_each_frame_as_often_as_it_stands_for(percent):
    rng = np.random.default_rng(0)
    values, counts = rng.random(200), rng.integers(1, 30, 200)
    expected = np.percentile(np.repeat(values, counts), percent, method="inverted_cdf")
    assert find_weighted_percentile(values, counts.astype(float), percent) == expected
    if percent < 100:
        assert expected != np.percentile(values, percent, method="inverted_cdf")
