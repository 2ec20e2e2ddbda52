"""Frames of a clip, for tests."""

from contextlib import closing

import numpy as np


def positions_of(blocks):
    """Positions (k, m, 3) of all blocks; the first frame that could not be read raises."""
    found = []
    for block in blocks:
        block.raise_read_errors()
        found.append(block.positions)
    return np.concatenate(found)


def frames_of(sequence, size=2, jobs=2):
    """Positions (F, m, 3) of a clip; its threads have ended, also when a frame is refused."""
    with closing(sequence.blocks(size, jobs)) as blocks:
        return positions_of(blocks)
