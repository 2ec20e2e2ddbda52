"""Gaps are filled linearly, and at either end by the nearest frame."""

import numpy as np
import pytest

from cageik_cli.util.arrays import fill_gaps

KNOWN = np.array([1, 2, 5, 6, 7])
FRAMES = np.array([np.nan, 1, 5, np.nan, np.nan, 8, 6, 2, np.nan])[:, None, None]
FILLED = [1, 1, 5, 6, 7, 8, 6, 2, 2]


@pytest.mark.parametrize("size", [1, 2, 4, 9])
def test_blocks_of_any_size_are_filled_alike(size):
    for start in range(0, len(FRAMES), size):
        block = FRAMES[start : start + size].copy()
        fill_gaps(block, start, KNOWN, lambda k: FRAMES[k])
        np.testing.assert_allclose(block.ravel(), FILLED[start : start + size], rtol=1e-15)


def test_what_has_no_gap_is_not_read():
    block = np.ones((3, 1, 1))
    fill_gaps(block, 0, np.arange(3), None)
    assert (block == 1).all()
