"""Groups of what pairs tie together: connected components."""

import numpy as np

from cageik_cli.util.arrays import Integers


def find_groups(pairs: Integers, size: int) -> Integers:
    """Return equal numbers for what `pairs`, (p, 2), tie together, (size,), by first members.

    Every group takes the smallest number that its neighbours have, until none changes; numbers
    that lead to smaller ones are followed at once, so that few rounds are needed.
    """
    lowest = np.arange(size)
    one, two = pairs.T
    while len(one):
        first, second = lowest[one], lowest[two]
        is_apart = first != second
        one, two, first, second = (part[is_apart] for part in (one, two, first, second))
        np.minimum.at(lowest, np.maximum(first, second), np.minimum(first, second))
        while (followed := lowest[lowest]).tobytes() != lowest.tobytes():
            lowest = followed
    return np.unique(lowest, return_inverse=True)[1]
