"""The displacements that weights are fitted to, in memory once, and subsets of their frames."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cageik_cli.util.arrays import Floats, Integers

FRAMES_PER_BLOCK = 16
ROWS_PER_PRODUCT = 4096
"""Sizes of blocks; constant, because the last digits depend on them."""


@dataclass(frozen=True, slots=True, eq=False)
class Displacements:
    """Displacements D of frames from the rest pose, aligned with it.

    Attributes
    ----------
    columns : (m, 3K) float32 or float64
        Of all frames in memory, frame by frame.
    frames : (k,) int64
        The frames that count, in ascending order; the others are as if they were not there.
    """

    columns: NDArray[np.floating]
    frames: Integers

    @staticmethod
    def of(columns: NDArray[np.floating]) -> "Displacements":
        """Return displacements of which all frames count."""
        return Displacements(columns, np.arange(columns.shape[1] // 3))

    def __len__(self) -> int:
        return len(self.frames)

    def take(self, frames: Integers) -> "Displacements":
        """Return the displacements of some of the frames in memory; shares the memory."""
        return replace(self, frames=np.asarray(frames, np.int64))

    def blocks(self) -> Iterator[Floats]:
        """Yield the displacements of the frames that count, (m, 3b) float64, in blocks."""
        for start in range(0, len(self), FRAMES_PER_BLOCK):
            chosen = _list_columns(self.frames[start : start + FRAMES_PER_BLOCK])
            yield self.columns[:, chosen].astype(np.float64, order="C", copy=False)

    def multiply(self, factor: Floats) -> Floats:
        """Return D times `factor`, (3k, b), as (m, b)."""
        spread = np.zeros((self.columns.shape[1], factor.shape[1]))
        spread[_list_columns(self.frames)] = factor
        product = np.empty((len(self.columns), factor.shape[1]))
        for start in range(0, len(product), ROWS_PER_PRODUCT):
            rows = slice(start, start + ROWS_PER_PRODUCT)
            np.matmul(self.columns[rows].astype(np.float64, copy=False), spread, out=product[rows])
        return product


def _list_columns(frames: Integers) -> Integers:
    """Return the columns of x, y and z of frames."""
    return (3 * frames[:, None] + np.arange(3)).ravel()
