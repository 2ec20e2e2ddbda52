import numpy as np
import pytest

from cageik_cli.fit.problem import estimate_memory
from cageik_cli.fit.sample import count_nearest, sample_frames, spread_points
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.util.errors import FormatError, InputError
from cageik_cli.util.settings import DEFAULT_MEMORY
from tests.fitted import Frames, clip_of, small_binding, true_weights

BINDING = small_binding()
CLIP = clip_of(BINDING, true_weights(BINDING), 40)
SOLVER = DualLaplacianSolver(BINDING, SolveSettings())


class BadFrames(Frames):
    """Frames 1 and 2 cannot be read."""

    def read_frame(self, index):
        if index in (1, 2):
            raise FormatError(f"frame {index}: is damaged")
        return super().read_frame(index)


class Unreadable(Frames):
    """No frame can be read."""

    def read_frame(self, index):
        raise FormatError(f"frame {index}: is damaged")


def sampled(clip=CLIP, kind=Frames, **settings):
    settings = {"memory": DEFAULT_MEMORY, "jobs": 1} | settings
    return sample_frames([kind(clip)], SOLVER, **settings)


def test_all_frames_are_taken_when_there_are_few():
    sample = sampled()
    np.testing.assert_array_equal(sample.frames, np.arange(40))
    aligned = np.hstack(list(sample.target.blocks()))
    np.testing.assert_allclose(aligned, SOLVER.align(CLIP)[0], rtol=0, atol=1e-13)
    assert sample.target.weight == 40


def test_a_sample_stands_for_all_frames():
    sample = sampled(max_frames=10)
    assert len(sample) == len(sample.target) == 10
    assert sample.target.weight == 40
    assert sample.target.shares.min() >= 1


def test_poses_are_spread_and_not_frame_numbers():
    """39 nearly equal frames and one other: both are in a sample of two."""
    clip = np.repeat(CLIP[:1], 40, axis=0)
    clip[17] = CLIP[5]
    clip[3:6] += 1e-9 * CLIP[2:5]
    sample = sampled(clip, max_frames=2)
    assert 17 in sample.frames
    assert sorted(sample.target.shares) == [1, 39]


def test_equal_frames_are_taken_once():
    sample = sampled(np.repeat(CLIP[:2], 20, axis=0), max_frames=10)
    assert len(sample) < 10
    assert sample.target.weight == 40


def test_little_memory_gives_fewer_frames_of_single_precision_and_no_other_choice():
    plenty = sampled(max_frames=4)
    m, n = BINDING.weights.shape
    least = estimate_memory(m, n, jobs=1)
    scarce = sampled(max_frames=4, memory=least + 4 * 2 * 12 * m)
    np.testing.assert_array_equal(scarce.frames, plenty.frames)
    assert scarce.target.parts[0].dtype == np.float32
    np.testing.assert_allclose(scarce.target.parts[0], plenty.target.parts[0], rtol=0, atol=1e-6)
    assert len(sampled(memory=0)) == 1


def test_bad_frames_are_refused_or_left_out():
    with pytest.raises(FormatError, match="frame 1"):
        sampled(kind=BadFrames)
    sample = sampled(kind=BadFrames, skips_bad_frames=True)
    assert set(range(40)) - set(sample.frames) == {1, 2}


def test_clips_without_readable_frames_are_refused():
    with pytest.raises(InputError, match="no frame"):
        sampled(CLIP[:0], skips_bad_frames=True)
    with pytest.raises(InputError, match="no frame"):
        sampled(kind=Unreadable, skips_bad_frames=True)


def test_spread_points_are_the_farthest():
    points = np.array([[1.0], [1.1], [5], [-4], [5]])
    np.testing.assert_array_equal(spread_points(points, 2), [2, 3])
    np.testing.assert_array_equal(spread_points(points, 3), [0, 2, 3])
    np.testing.assert_array_equal(count_nearest(points, np.array([0, 2, 3])), [2, 2, 1])
    np.testing.assert_array_equal(spread_points(points, 9), np.arange(5))


def test_every_second_of_ten_blocks_is_held_out():
    sample = sampled()
    np.testing.assert_array_equal(sample.in_held_out_block, np.arange(40) // 4 % 2 == 1)
    np.testing.assert_array_equal(sample.in_last_third, np.arange(40) >= 27)
