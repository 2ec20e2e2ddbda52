"""Frames of a clip, for tests."""

import numpy as np


def positions_of(blocks):
    """Positions (k, m, 3) of all blocks; the first frame that could not be read raises."""
    found = []
    for block in blocks:
        block.refuse_faults()
        found.append(block.positions)
    return np.concatenate(found)


def frames_of(sequence, size=2, jobs=2):
    """Positions (F, m, 3) of a clip."""
    return positions_of(sequence.blocks(size, jobs))
