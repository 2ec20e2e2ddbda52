"""Few morph targets whose weighted sums are the frames of an animation: its singular vectors."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cageik_cli.formats.gltf.glb_file import Singles
from cageik_cli.formats.gltf.vector_spool import VectorSpool
from cageik_cli.util.arrays import Floats, spread_evenly

EXACT_TOL = 1e-6
"""Of the diagonal: errors below this are rounding in single precision."""

MAX_SAMPLED_FRAMES = 1024
"""Frames of which the singular vectors are taken, at most; spread over the animation."""

MAX_PRODUCT_BYTES = 1 << 28
"""Bytes of the products of all frames with those, at most."""

RANK_TOL = 1e-14
"""Squares of singular values below this share of the largest are rounding."""


@dataclass(frozen=True, eq=False)
class Modes:
    """The mean of F frames of displacements D, (F, 3 m), and K - 1 singular vectors around it.

    The first target has weight one in all frames: what it holds makes the weights of the others
    begin at zero. Programs with sliders, such as Blender, cut off weights below zero or above one.

    Attributes
    ----------
    sums : (K - 1, F) float64
        Singular vectors are `sums @ D`, the strongest first.
    loads : (F, K - 1) float64
        Frames are nearly the mean plus `loads` times the vectors.
    residuals : (K,) float64
        Sum of the squares that the mean and the first k vectors leave.
    """

    sums: Floats
    loads: Floats
    residuals: Floats

    @property
    def count(self) -> int:
        """The number of targets, K."""
        return len(self.residuals)

    def truncate(self, count: int) -> "Modes":
        """Return the modes of the first `count` targets."""
        return Modes(self.sums[: count - 1], self.loads[:, : count - 1], self.residuals[:count])

    @cached_property
    def weights(self) -> Singles:
        """The weights of the targets, (F, K), from 0 to 1."""
        scaled = (self.loads - self._low) / self._range
        return np.insert(scaled, 0, 1, axis=1).clip(0, 1).astype(np.float32)

    def compute_targets(self, block: Floats) -> Singles:
        """Return the targets (K, b, 3) of displacements (F, 3 b)."""
        first = 1 / len(block) + self._low @ self.sums
        return _round_targets(np.vstack([first, self.sums * self._range[:, None]]) @ block)

    def fit_targets(self, block: Floats) -> Singles:
        """Return the targets (K, b, 3) nearest to vectors (F, 3 b) with these weights."""
        return _round_targets(self._inverse @ block)

    @cached_property
    def _inverse(self) -> Floats:
        return np.asarray(np.linalg.pinv(self.weights.astype(np.float64)))

    @cached_property
    def _low(self) -> Floats:
        return np.asarray(self.loads.min(axis=0))

    @cached_property
    def _range(self) -> Floats:
        return np.asarray(np.ptp(self.loads, axis=0))


def _round_targets(targets: Floats) -> Singles:
    return targets.astype(np.float32).reshape(len(targets), -1, 3)


@dataclass(frozen=True, slots=True)
class MorphError:
    """Distances of the morphed vertices from the frames, over all vertices and frames.

    Attributes
    ----------
    rms, largest : float
        In the unit of the frames.
    """

    rms: float
    largest: float


def compute_modes(spool: VectorSpool, limit: int) -> Modes:
    """Compute the mean and singular vectors of displacements, at most `limit` targets.

    They come from the products of frames with each other, so no more than a block of vertices is
    in memory. Signs are such that the load of largest size of each vector is above zero.
    """
    frames = spool.frame_count
    count = min(frames, MAX_SAMPLED_FRAMES, max(limit, MAX_PRODUCT_BYTES // (8 * frames)))
    sampled = spread_evenly(frames, count)
    products, total, spread = np.zeros((frames, count)), 0.0, 0.0
    for _, block in spool.read_blocks(0, spool.vertex_count):
        total += float(np.einsum("fc,fc->", block, block))
        block -= block.mean(axis=0)
        spread += float(np.einsum("fc,fc->", block, block))
        products += block @ block[sampled].T
    values, vectors = np.linalg.eigh(products[sampled])
    kept = min(int((values > RANK_TOL * total).sum()), limit - 1)
    values, vectors = values[::-1][:kept], vectors[:, ::-1][:, :kept]
    vectors = vectors / np.sqrt(values)
    loads = products @ vectors
    signs = np.sign(loads[np.abs(loads).argmax(axis=0), np.arange(kept)])
    sums = np.zeros((kept, frames))
    sums[:, sampled] = (vectors * signs).T
    sums -= sums.mean(axis=1, keepdims=True)  # of displacements from their mean
    residuals = spread - np.concatenate([[0], np.cumsum(np.square(loads).sum(axis=0))])
    return Modes(sums, loads * signs, np.maximum(residuals, 0))


def measure_modes(spool: VectorSpool, modes: Modes) -> MorphError:
    """Measure what the modes leave, with targets and weights as they are written."""
    weights = modes.weights.astype(np.float64)
    squares, largest = 0.0, 0.0
    for _, block in spool.read_blocks(0, spool.vertex_count):
        targets = modes.compute_targets(block).astype(np.float64)
        misses = block - weights @ targets.reshape(len(targets), -1)
        distances = np.square(misses).reshape(len(block), -1, 3).sum(axis=2)
        squares += float(distances.sum())
        largest = max(largest, float(distances.max()))
    count = spool.frame_count * spool.vertex_count
    return MorphError(float(np.sqrt(squares / count)), float(np.sqrt(largest)))


def choose_modes(spool: VectorSpool, modes: Modes, tolerance: float) -> tuple[Modes, MorphError]:
    """Return the fewest targets whose largest error is at most `tolerance`, or all, and the error.

    The rms error, which is known for any number, is a lower bound; between it and all modes the
    number is found by bisection.
    """
    error = measure_modes(spool, modes)
    if error.largest > tolerance:
        return modes, error
    count = spool.frame_count * spool.vertex_count
    enough = np.flatnonzero(modes.residuals <= count * tolerance**2)
    high = modes.count
    low = 1 + int(enough[0]) if len(enough) else high
    while low < high:
        middle = (low + high) // 2
        found = measure_modes(spool, modes.truncate(middle))
        if found.largest <= tolerance:
            high, error = middle, found
        else:
            low = middle + 1
    return modes.truncate(high), error
