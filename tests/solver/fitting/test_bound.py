import numpy as np
import pytest

from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.solver.fitting.bound import BoundAccumulator, bound_rank
from cageik_cli.solver.fitting.sample import SampleSettings, sample_frames
from cageik_cli.solver.settings import SolveSettings
from tests.fitted import Frames, clip_of, small_binding, true_weights

BINDING = small_binding()
CLIP = clip_of(BINDING, true_weights(BINDING), 20)
COUNTS = np.where(np.arange(len(BINDING.rest.vertices)) < 9, 0.0, 1.0)


def exact(solver, frames, points):
    """The singular values beyond `points`, by numpy."""
    data = solver.align(frames).columns[solver.data_vertices]
    left = np.linalg.svd(data, compute_uv=False)[points:]
    return 100 * np.sqrt((left**2).sum() / (data.size / 3)) / BINDING.rest.diagonal


def sampled(solver, **settings):
    return sample_frames([Frames(CLIP)], solver, SampleSettings(**settings)).target


@pytest.mark.parametrize("counts", [None, COUNTS])
@pytest.mark.parametrize("points", [4, 10])
def test_the_bound_of_all_frames_is_that_of_the_singular_values(points, counts):
    solver = DualLaplacianSolver(BINDING, SolveSettings(), counts)
    found = bound_rank(solver, sampled(solver), points)
    expected = exact(solver, CLIP, points)
    assert found.lowest <= expected * (1 + 1e-9)
    assert expected <= found.highest * (1 + 1e-9)
    assert found.highest == pytest.approx(found.lowest, rel=1e-6)


def test_a_sample_bounds_the_error_of_all_frames():
    solver = DualLaplacianSolver(BINDING, SolveSettings())
    accumulator = BoundAccumulator(solver, sampled(solver, max_frames=5), 6)
    for start in range(0, 20, 7):
        accumulator.update(CLIP[start : start + 7])
    found = accumulator.finish()
    assert found.lowest <= exact(solver, CLIP, 6) <= found.highest
    assert found.lowest < found.highest


def test_as_many_points_as_directions_leave_nothing():
    solver = DualLaplacianSolver(BINDING, SolveSettings())
    assert bound_rank(solver, sampled(solver), 60).highest < 1e-5


def test_a_clip_that_does_not_move_has_bound_zero():
    solver = DualLaplacianSolver(BINDING, SolveSettings())
    still = np.repeat(BINDING.rest.vertices[None], 4, axis=0)
    target = sample_frames([Frames(still)], solver, SampleSettings()).target
    assert bound_rank(solver, target, 5).highest < 1e-10
