"""A square of two triangles, seen from the front."""

import numpy as np

SIZE = 100
SQUARE = np.array([[0, 1, 2], [0, 2, 3]])


def square(low, high, depth=0.0):
    """The corners of a square."""
    return np.array(
        [[low, low, depth], [high, low, depth], [high, high, depth], [low, high, depth]]
    )
