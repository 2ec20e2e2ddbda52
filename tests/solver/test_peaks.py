import numpy as np
import pytest

from cageik_cli.solver.peaks import DeviationPeaks


@pytest.mark.parametrize("size", [1, 5, 17])
def test_merged_peaks_of_blocks_are_the_maxima_over_all_frames(size):
    squares = np.random.default_rng(0).integers(0, 4, (17, 40)).astype(float)
    merged = DeviationPeaks.none(40)
    for start in range(0, 17, size):
        block = squares[start : start + size]
        merged = merged.merge(DeviationPeaks.of_frames(block, start + np.arange(len(block))))
    np.testing.assert_array_equal(merged.deviations, np.sqrt(squares.max(axis=0)))
    # The first frame of equal ones, in whatever blocks.
    np.testing.assert_array_equal(merged.frames, squares.argmax(axis=0))


def test_vertices_without_data_and_without_deviation_have_no_frame():
    squares = np.array([[1.0, np.nan, 0.25, 0.0], [4.0, np.nan, 0.0, 0.0]])
    found = DeviationPeaks.of_frames(squares, np.array([10, 12]))
    assert found.deviations.tolist() == [2, 0, 0.5, 0]
    assert found.frames.tolist() == [12, -1, 10, -1]


def test_no_frames_have_no_peaks():
    found = DeviationPeaks.of_frames(np.empty((0, 2)), np.empty(0, np.int64))
    assert found.deviations.tolist() == [0, 0]
    assert found.frames.tolist() == [-1, -1]
