"""The displacements that weights are fitted to, in memory once, and subsets of their frames.

Sums of squares over the frames do not change when the columns of D are turned by an orthogonal
matrix, and a linear solve for the cages turns with them. In the eigenvectors of DᵀD, the last
columns are nearly 0; a fit to the others is the same, and faster.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cageik_cli.util.arrays import Floats, Integers

FRAMES_PER_PART = 16
"""Frames per block; constant, because the last digits depend on it."""

COMPRESSION_TOL = 2e-3
"""What a compression leaves out, relative to D, as root mean squares."""


@dataclass(frozen=True, slots=True, eq=False)
class Displacements:
    """Displacements D of frames from the rest pose, aligned with it.

    Attributes
    ----------
    parts : tuple of (m, 3b) float32 or float64
        Of all frames in memory, frame by frame; each part but the last has `FRAMES_PER_PART`.
        Scaled by the roots of their shares, so that sums of squares weigh the frames.
    frames : (k,) int64
        The frames that count, in ascending order; the others are as if they were not there.
    shares : (K,) float64
        How many frames of the clips each frame in memory stands for.
    """

    parts: tuple[NDArray[np.floating], ...]
    frames: Integers
    shares: Floats

    @staticmethod
    def of(columns: NDArray[np.floating]) -> "Displacements":
        """Return displacements (m, 3k), all frames of which count."""
        count = columns.shape[1] // 3
        return Displacements.join(np.split(columns, count, axis=1), np.ones(count))

    @staticmethod
    def join(frames: Sequence[NDArray[np.floating]], shares: Floats) -> "Displacements":
        """Return the displacements of frames, (m, 3) each, that stand for `shares` frames."""
        parts = []
        for start in range(0, len(frames), FRAMES_PER_PART):
            part = np.hstack(frames[start : start + FRAMES_PER_PART])
            scales = np.sqrt(shares[start : start + FRAMES_PER_PART])
            part *= np.repeat(scales, 3).astype(part.dtype)
            parts.append(part)
        return Displacements(tuple(parts), np.arange(len(frames)), shares)

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def weight(self) -> float:
        """Return how many frames of the clips the frames that count stand for."""
        return float(self.shares[self.frames].sum())

    @property
    def nbytes(self) -> int:
        """Return the bytes that all frames in memory take."""
        return sum(part.nbytes for part in self.parts)

    def take(self, frames: Integers) -> "Displacements":
        """Return the displacements of some of the frames in memory; shares the memory."""
        return replace(self, frames=np.sort(np.asarray(frames, np.int64)))

    def blocks(self) -> Iterator[Floats]:
        """Yield the displacements of the frames that count, (m, 3b) float64, in blocks."""
        for first, part in zip(self._starts(), self.parts, strict=True):
            chosen = self._choose_columns(first, part)
            if len(chosen):
                columns = part if len(chosen) == part.shape[1] else part[:, chosen]
                yield np.ascontiguousarray(columns, np.float64)

    def multiply(self, factor: Floats) -> Floats:
        """Return D times `factor`, (3k, b), as (m, b)."""
        product = np.zeros((len(self.parts[0]), factor.shape[1]))
        done = 0
        for block in self.blocks():
            product += block @ factor[done : done + block.shape[1]]
            done += block.shape[1]
        return product

    def multiply_left(self, factor: Floats) -> Floats:
        """Return `factor`, (b, m), times D, as (b, 3k)."""
        return np.hstack([factor @ block for block in self.blocks()])

    def multiply_by_transpose(
        self, row_weights: Floats | None = None, max_entries: int = 1 << 20
    ) -> Floats:
        """Return DᵀΩD, (3k, 3k), with Ω the diagonal of `row_weights`, (m,), or the identity.

        So many entries of rows of D are multiplied at once.
        """
        count = 3 * len(self)
        rows = max(1, max_entries // count)
        product = np.zeros((count, count))
        for start in range(0, len(self.parts[0]), rows):
            block = self._read_rows(slice(start, start + rows))
            if row_weights is not None:
                block *= np.sqrt(row_weights[start : start + rows, None])
            product += block.T @ block
        return product

    def compress(self, row_weights: Floats | None = None) -> "Displacements":
        """Return displacements with fewer columns, whose fit is the same but for `COMPRESSION_TOL`.

        Their frames are sums of frames; no single frame can be measured on them. Row weights are
        those of the vertices in the fit, (m,).
        """
        values, vectors = np.linalg.eigh(self.multiply_by_transpose(row_weights))
        left_out = np.cumsum(np.maximum(values, 0)) <= COMPRESSION_TOL**2 * values.sum()
        count = -(-int(np.count_nonzero(~left_out)) // 3)
        if not 0 < count <= 0.8 * len(self):  # else it would not be faster
            return self
        kept = vectors[:, ::-1][:, : 3 * count]
        width = 3 * FRAMES_PER_PART
        starts = range(0, kept.shape[1], width)
        parts = [self.multiply(kept[:, s : s + width]) for s in starts]
        parts = [part.astype(self.parts[0].dtype, copy=False) for part in parts]
        return Displacements(tuple(parts), np.arange(count), np.full(count, self.weight / count))

    def _read_rows(self, rows: slice) -> Floats:
        """Return rows of D, (r, 3k) float64."""
        chosen = [
            part[rows][:, self._choose_columns(first, part)]
            for first, part in zip(self._starts(), self.parts, strict=True)
        ]
        return np.hstack(chosen).astype(np.float64, copy=False)

    def _starts(self) -> range:
        return range(0, FRAMES_PER_PART * len(self.parts), FRAMES_PER_PART)

    def _choose_columns(self, first: int, part: NDArray[np.floating]) -> Integers:
        """Return the columns that count in a part which begins with frame `first`."""
        last = first + part.shape[1] // 3
        local = self.frames[(self.frames >= first) & (self.frames < last)] - first
        return np.asarray((3 * local[:, None] + np.arange(3)).ravel())
