from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.solver.blocks import summarize_blocks
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


@pytest.mark.parametrize(
    ("rest", "best"),
    [([2], 0), ([0, 2], 4), ([3], 2), ([0, 1, 2, 4], 2)],
)
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
