"""Which samples are frames."""

import pytest

from cageik_cli.formats.base.scene_graph import EVEN_STEP_TOL, Sampling, frames_per_second


@pytest.mark.parametrize(
    ("times", "step", "is_uneven"),
    [
        (set(), None, False),
        ({7.0}, None, False),
        ({1.0, 2.0, 3.0}, 1.0, False),
        ({-1.5, 0.0, 1.5}, 1.5, False),
        ({1.0, 2.0, 4.0}, None, True),
        ({0.0, 1.0, 2.0 + 4 * EVEN_STEP_TOL}, None, True),
        ({0.0, 1.0, 2.0 + EVEN_STEP_TOL / 4}, 1 + EVEN_STEP_TOL / 8, False),
    ],
)
def test_frames_are_the_samples_in_order(times, step, is_uneven):
    sampling = Sampling.from_times(times)
    assert sampling.times.tolist() == sorted(times or {0.0})
    assert sampling.step == step
    assert sampling.is_uneven == is_uneven


@pytest.mark.parametrize("fps", [24, 25, 29.97, 120])
def test_the_rate_of_times_counted_up_from_far(fps):
    times = {86400 + k / fps for k in range(2000)}
    assert frames_per_second(Sampling.from_times(times).step) == pytest.approx(fps, rel=1e-8)
    assert frames_per_second(1 / fps) == fps
