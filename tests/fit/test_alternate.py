"""Figures of a sample stand for all frames of its clips."""

import numpy as np
import pytest

from cageik_cli.fit.alternate import CageSolve, find_weighted_percentile
from cageik_cli.fit.problem import Displacements
from cageik_cli.method.solve.settings import SolveSettings
from tests.fitted import clip_of, small_binding, true_weights


@pytest.mark.parametrize("percent", [1, 50, 99, 100])
def test_a_percentile_counts_each_frame_as_often_as_it_stands_for(percent):
    rng = np.random.default_rng(0)
    values, counts = rng.random(200), rng.integers(1, 30, 200)
    expected = np.percentile(np.repeat(values, counts), percent, method="inverted_cdf")
    assert find_weighted_percentile(values, counts.astype(float), percent) == expected
    if percent < 100:
        assert expected != np.percentile(values, percent, method="inverted_cdf")


def test_a_frame_that_stands_for_three_is_measured_as_three():
    binding = small_binding()
    clip = clip_of(binding, true_weights(binding), 4) - binding.rest.vertices
    solve = CageSolve(binding, SolveSettings(), None)
    shares = np.array([1.0, 3, 1, 3])
    repeated = Displacements.join(np.repeat(clip, shares.astype(int), axis=0), np.ones(8))
    found, expected = (
        solve.measure(binding.weights, target)
        for target in (Displacements.join(clip, shares), repeated)
    )
    for name in ("rms", "percentile", "largest"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-5)
