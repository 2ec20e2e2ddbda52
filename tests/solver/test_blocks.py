from dataclasses import replace

import numpy as np

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
    assert summary.key_frames.tolist() == [1, 0, 2]  # of 1, 2, 4 and 9 the lower median is 2
    squares = sum(block.squared_errors for block in BLOCKS)
    np.testing.assert_allclose(summary.vertex_rms, np.sqrt(squares / 4), rtol=1e-15)
