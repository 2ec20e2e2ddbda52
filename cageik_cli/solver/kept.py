"""What was kept of a block of frames, and how much each of the other vertices counts."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.solver.metrics import KeptMetrics
from cageik_cli.util.arrays import Floats, Integers, Mask


@dataclass(frozen=True, slots=True, eq=False)
class SparseWeights:
    """The weights of the vertices of k frames that are not 1.

    Attributes
    ----------
    starts : (k + 1,) int64
        Where the entries of each frame begin and end.
    vertices : (e,) int64
    values : (e,) float64
    """

    starts: Integers
    vertices: Integers
    values: Floats

    @staticmethod
    def of(weights: Floats) -> "SparseWeights":
        """Take those that are not 1 of weights (k, m)."""
        frames, vertices = np.nonzero(weights != 1)
        starts = np.searchsorted(frames, np.arange(len(weights) + 1))
        return SparseWeights(starts, vertices, weights[frames, vertices])

    @staticmethod
    def none(frames: int) -> "SparseWeights":
        """Return the weights of frames in which all are 1."""
        return SparseWeights(np.zeros(frames + 1, np.int64), np.zeros(0, np.int64), np.zeros(0))

    def get(self, place: int) -> tuple[Integers, Floats]:
        """Return the vertices of a frame, by its place, and their weights."""
        entries = slice(self.starts[place], self.starts[place + 1])
        return self.vertices[entries], self.values[entries]

    def expand(self, vertex_count: int) -> Floats:
        """Return all weights, (k, m)."""
        weights = np.ones((len(self.starts) - 1, vertex_count))
        for place, row in enumerate(weights):
            vertices, values = self.get(place)
            row[vertices] = values
        return weights


@dataclass(frozen=True, slots=True, eq=False)
class KeptBlock:
    """What was kept of k frames.

    Attributes
    ----------
    metrics : KeptMetrics
        nan, and -1 for counts, of skipped frames.
    weights : SparseWeights
        None of skipped frames.
    counts : (m,) int64
        Frames in which each vertex was kept.
    noise : (k,) float64
        As of `measure_noise`; nan where a frame of the block is missing beside it.
    """

    metrics: KeptMetrics
    weights: SparseWeights
    counts: Integers
    noise: Floats


def measure_noise(errors: Floats, is_kept: Mask) -> Floats:
    """Measure how much residuals tremble from frame to frame, (k,): a mean squared length.

    What a cage cannot follow changes slowly, and cancels in second differences; of independent
    noise they have six times the variance.

    Parameters
    ----------
    errors : (k, m, 3)
        v̂ − v.
    is_kept : (k, m) bool
    """
    noise = np.full(len(errors), np.nan)
    if len(errors) < 3:
        return noise
    bends = errors[:-2] - 2 * errors[1:-1] + errors[2:]
    counted = is_kept[:-2] & is_kept[1:-1] & is_kept[2:]
    squares = np.einsum("kjx,kjx->kj", bends, bends)
    counts = counted.sum(axis=1)
    sums = np.where(counted, squares, 0.0).sum(axis=1)
    noise[1:-1] = np.where(counts > 0, sums / (6 * np.maximum(counts, 1)), np.nan)
    return noise
