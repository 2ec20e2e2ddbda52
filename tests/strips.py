"""A strip that is folded at its middle: two legs, which touch when the fold is closed."""

import numpy as np

from cageik_cli.geometry.mesh import TriMesh

COLUMNS, ROWS = 81, 5


def fold_strip(angle: float) -> np.ndarray:
    """Positions of the strip whose legs lean this much, in radians, from each other."""
    along, across = np.meshgrid(np.linspace(-1, 1, COLUMNS), np.linspace(0, 0.1, ROWS))
    x, y = along * np.sin(angle), np.abs(along) * np.cos(angle)
    return np.stack([x, y, across], axis=-1).reshape(-1, 3)


def make_strip(angle: float) -> TriMesh:
    """The strip in this pose."""
    first = (np.arange(ROWS - 1)[:, None] * COLUMNS + np.arange(COLUMNS - 1)).reshape(-1)
    a, b, c, d = first, first + 1, first + COLUMNS + 1, first + COLUMNS
    return TriMesh(
        fold_strip(angle), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    )
