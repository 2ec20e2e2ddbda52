"""What is known of a clip after its blocks: its summary, the peaks, and what is possible."""

from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.method.solve.blocks import KeptBlock
from cageik_cli.method.solve.dual_laplacian import (
    MAX_BOUND_VERTICES,
    MIN_BOUND_VERTICES,
    spread_vertices,
)
from cageik_cli.method.solve.metrics import DeviationPeaks
from cageik_cli.method.solve.summary import (
    OcclusionTracker,
    VertexBoundAccumulator,
    summarize_blocks,
)
from tests.store.test_checkpoint import BLOCKS


def test_blocks_are_summarized():
    blocks = [replace(block, metrics=replace(block.metrics)) for block in BLOCKS]
    rms = [np.array([2.0, 9.0]), np.array([1.0, np.nan]), np.array([4.0])]
    for block, column in zip(blocks, rms, strict=True):
        object.__setattr__(block.metrics, "rms", column)
    summary = summarize_blocks(blocks)
    assert summary.skipped == BLOCKS[1].skipped
    assert summary.digests == [digest for block in BLOCKS for digest in block.digests]
    # Of 1, 2, 4 and 9 the lower median is 2.
    assert summary.find_key_frames().tolist() == [1, 0, 2]
    np.testing.assert_array_equal(summary.frame_rms, [2, 9, 1, np.nan, 4])
    peaks = np.max([block.peaks.deviations for block in BLOCKS], axis=0)
    np.testing.assert_array_equal(summary.peaks.deviations, peaks)
    squares = sum(block.squared_errors for block in BLOCKS)
    np.testing.assert_allclose(summary.vertex_rms, np.sqrt(squares / 4), rtol=1e-15)


@pytest.mark.parametrize(("rest", "best"), [([2], 0), ([0, 2], 4), ([3], 2), ([0, 1, 2, 4], 2)])
def test_the_best_frame_is_not_the_rest_pose(rest, best):
    """Frame 3 is skipped; if all frames are the rest pose, the best of all is the best."""
    blocks = [replace(block, metrics=replace(block.metrics)) for block in BLOCKS]
    rms = [np.array([2.0, 9.0]), np.array([1.0, np.nan]), np.array([4.0])]
    for block, column in zip(blocks, rms, strict=True):
        object.__setattr__(block.metrics, "rms", column)
    key_frames = summarize_blocks(blocks).find_key_frames(np.isin(np.arange(5), rest))
    assert key_frames.tolist() == [1, 0, best]


def test_no_frame_has_no_key_frames():
    bad = replace(BLOCKS[1], skipped={2: "bad", 3: "bad"}, start=0)
    object.__setattr__(bad, "metrics", replace(bad.metrics, rms=np.full(2, np.nan)))
    assert summarize_blocks([bad]).find_key_frames().tolist() == []


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


POINTS = 4


def clip(vertices, frames, seed=1):
    return np.random.default_rng(seed).normal(size=(vertices, 3 * frames)).astype(np.float32)


def accumulate(columns, frames, step=2):
    bound = VertexBoundAccumulator()
    for start in range(0, columns.shape[1], 3 * step):
        bound.update(columns[:, start : start + 3 * step])
    return bound.finish(POINTS, frames)


@pytest.mark.parametrize(("vertices", "frames"), [(30, 5), (30, 10), (30, 40), (7, 40), (3, 9)])
def test_it_is_what_the_truncated_decomposition_leaves(vertices, frames):
    """Fewer columns than vertices, as many, and more."""
    columns = clip(vertices, frames)
    left = np.linalg.svd(columns.astype(float), compute_uv=False)[POINTS:]
    expected = 100 * np.sqrt((left**2).sum() / (vertices * frames))
    for step in (1, 3, 100):
        found = accumulate(columns, frames, step)
        assert found.rms_percent == pytest.approx(expected, rel=1e-9)
        assert (found.points, found.vertices) == (POINTS, vertices)


def test_gaps_do_not_count():
    columns = clip(20, 10)
    with_gaps = np.hstack([columns, np.zeros((20, 6), np.float32)])
    assert accumulate(with_gaps, 10).rms_percent == pytest.approx(
        accumulate(columns, 10).rms_percent, rel=1e-9
    )


def test_a_motion_of_few_points_can_be_exact():
    columns = (clip(50, 1) @ clip(3, 20).astype(np.float32)).astype(np.float32)
    assert accumulate(columns, 20).rms_percent < 1e-3


def test_nothing_has_no_bound():
    assert VertexBoundAccumulator().finish(POINTS, 3) is None
    empty = VertexBoundAccumulator()
    empty.update(np.empty((0, 6), np.float32))
    assert empty.finish(POINTS, 2) is None
    assert accumulate(np.zeros((5, 3), np.float32), 0) is None


@pytest.mark.parametrize(
    ("count", "points", "expected"),
    [
        (100, 60, 100),
        (10_000, 8, MIN_BOUND_VERTICES),
        (10_000, 100, 800),
        (10_000, 500, MAX_BOUND_VERTICES),
    ],
)
def test_vertices_are_spread_over_the_numbers(count, points, expected):
    numbers = 3 * np.arange(count)
    found = spread_vertices(numbers, points)
    assert len(np.unique(found)) == expected
    assert np.isin(found, numbers).all()
    assert (found[0], found[-1]) == (0, numbers[-1])
    assert np.diff(found).max() <= 3 * (count // expected + 1)


def count_absences(weights, skipped=(), size=4):
    """OcclusionTracker of weights (F, m), in blocks of `size` frames."""
    found, weights = OcclusionTracker(weights.shape[1]), weights.copy()
    weights[list(skipped)] = 1  # as a block stores them
    for start in range(0, len(weights), size):
        block = weights[start : start + size]
        rows, vertices = np.nonzero(block != 1)
        starts = np.searchsorted(rows, np.arange(len(block) + 1))
        kept = KeptBlock(None, starts, vertices, block[rows, vertices], None)
        found.update(kept, range(start, start + len(block)), skipped)
    return found


def hide(count, *spans):
    """Weights of one vertex per span, and of one that is seen in all frames."""
    weights = np.ones((count, len(spans) + 1))
    for vertex, (first, last) in enumerate(spans):
        weights[first:last, vertex] = 0
    return weights


@pytest.mark.parametrize("size", [1, 4, 40])
def test_long_absences_are_found_in_their_frames_only(size):
    """Over the borders of blocks, at the start and at the end; 10 frames are not long."""
    spans = [(0, 11), (3, 13), (9, 29), (29, 40)]
    found = count_absences(hide(40, *spans), size=size)
    assert found.longest.tolist() == [11, 10, 20, 11, 0]
    assert found.has_long
    for frame in range(40):
        expected = [k for k in (0, 2, 3) if spans[k][0] <= frame < spans[k][1]]
        assert found.find_long(frame).tolist() == expected


def test_a_vertex_that_is_seen_now_and_then_is_not_hidden_for_long():
    weights = hide(60, (0, 60))
    weights[10::11] = 1
    weights[5::11, 0] = 0.3
    found = count_absences(weights)
    assert not found.has_long
    assert all(not len(found.find_long(frame)) for frame in range(60))


@pytest.mark.parametrize("size", [1, 4, 100])
def test_a_skipped_frame_does_not_end_an_absence(size):
    found = count_absences(hide(110, (5, 105)), range(0, 110, 10), size)
    assert found.longest.tolist() == [100, 0]
    assert [frame for frame in range(110) if len(found.find_long(frame))] == list(range(5, 105))


def test_skipped_frames_alone_are_no_absence():
    """Hidden for 6 frames each before and behind a gap, the one before seen behind it."""
    found = count_absences(hide(40, (4, 10), (30, 36)), range(10, 30))
    assert found.longest.tolist() == [6, 6, 0]
    assert not found.has_long
