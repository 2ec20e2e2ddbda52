"""What is known of a clip after its blocks: skipped frames, errors of vertices, occlusions.

The error of the best possible cage animation of a clip is found on some vertices and all frames.
Displacements of s vertices in F frames are a matrix D, (s, 3F). Weights and cages with n points
give a matrix of rank n at most; the best one leaves the singular values of D beyond n (Eckart and
Young 1936). No cage of n points has a smaller error on these vertices. They are a sample of all, so
the error over all vertices is seldom smaller, and a few percent larger.
"""

from bisect import bisect_right
from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.method.solve.blocks import KeptBlock, SolvedBlock
from cageik_cli.method.solve.metrics import DeviationPeaks
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.messages import Said

MIN_BOUND_PERCENT = 1e-3
"""A smaller bound is zero by counting, and rounding: the motion has no more dimensions than n."""

DEFAULT_BRIDGED_FRAMES = 10
"""Frames in a row for which the motion around them tells where occluded vertices are, at most, as
long as the clip has not been asked."""


@dataclass(frozen=True, slots=True)
class VertexBound:
    """The smallest error that a cage animation can have.

    Attributes
    ----------
    rms_percent : float
        Root mean square over all frames and the vertices that were sampled, in percent of the
        diagonal.
    points : int
        Number of vertices of the cage.
    vertices : int
        How many vertices were sampled.
    """

    rms_percent: float
    points: int
    vertices: int

    @property
    def is_trivial(self) -> bool:
        """Return whether it is zero by counting: frames are few, or repeat, and it says nothing."""
        return self.rms_percent < MIN_BOUND_PERCENT


class VertexBoundAccumulator:
    """Accumulates the displacements of a clip, block by block, in memory that does not grow.

    Columns are kept until there are as many as vertices; then only D Dᵀ is.
    """

    def __init__(self) -> None:
        self._columns: list[NDArray[np.float32]] = []
        self._gram: Floats | None = None

    def update(self, columns: NDArray[np.float32]) -> None:
        """Add the displacements of the next frames, (s, 3k), in diagonals of the rest pose."""
        self._columns.append(columns)
        if sum(part.shape[1] for part in self._columns) > len(columns) > 0:
            self._fold()

    def finish(self, points: int, frames: int) -> VertexBound | None:
        """Return the bound for a cage of `points` vertices, from so many frames without gaps.

        None if no displacements were added.
        """
        held = self._columns[0] if self._columns else self._gram
        if held is None or not len(held) or not frames:
            return None
        if self._gram is None:
            data = np.hstack(self._columns).astype(np.float64)
            gram = data.T @ data
        else:
            self._fold()
            gram = self._gram
        left = np.linalg.eigvalsh(gram)[::-1][points:]
        mean = float(np.maximum(left, 0).sum()) / (len(held) * frames)
        return VertexBound(float(100 * np.sqrt(mean)), points, len(held))

    def _fold(self) -> None:
        """Replace the columns by their part of D Dᵀ."""
        if not self._columns:
            return
        data = np.hstack(self._columns).astype(np.float64)
        product = data @ data.T
        self._gram = product if self._gram is None else self._gram + product
        self._columns = []


class OcclusionTracker:
    """How many frames in a row each vertex had no weight, counted block by block.

    A frame without data neither ends an occlusion nor begins one.

    Attributes
    ----------
    longest : (m,) int64
        Frames of the longest occlusion of each vertex.
    bridged : int
        Frames of an occlusion over which motion tells where the vertex is, at most.
    """

    def __init__(self, vertex_count: int) -> None:
        self.longest = np.zeros(vertex_count, np.int64)
        self.bridged = DEFAULT_BRIDGED_FRAMES
        # Lengths up to the last frame with data, and the frame behind it.
        self._lengths, self._stop = np.zeros(vertex_count, np.int64), 0
        # Occlusions that have ended, in this order.
        self._ended: list[tuple[range, Integers]] = []

    def update(self, kept: KeptBlock, frames: range, skipped: Collection[int]) -> None:
        """Count the frames of the next block, of which those that are skipped have no data."""
        for place, frame in enumerate(frames):
            if frame in skipped:
                continue
            vertices, weights = kept.get_weights(place)
            gone = vertices[weights == 0]
            before, self._lengths = self._lengths, np.zeros_like(self._lengths)
            self._lengths[gone] = np.where(before > 0, before + frame - self._stop, 0)[gone] + 1
            np.maximum(self.longest, self._lengths, out=self.longest)
            self._ended += self._list_spans(np.where(self._lengths > 0, 0, before))
            self._stop = frame + 1

    @property
    def has_long(self) -> bool:
        """Return whether a vertex is without weight for longer than time tells of."""
        return bool((self.longest > self.bridged).any())

    def find_long(self, frame: int) -> Integers:
        """Return the vertices without weight in a frame, and so long that no motion tells more."""
        first = bisect_right(self._ended, frame, key=_find_stop)
        last = bisect_right(self._ended, frame + int(self.longest.max()), key=_find_stop)
        spans = self._ended[first:last] + self._list_spans(self._lengths)
        found = [
            vertices for frames, vertices in spans if frame in frames and len(frames) > self.bridged
        ]
        return np.sort(np.concatenate(found)) if found else np.empty(0, np.int64)

    def _list_spans(self, lengths: Integers) -> list[tuple[range, Integers]]:
        """List occlusions of these lengths, (m,), that end here."""
        return [
            (range(self._stop - int(length), self._stop), np.flatnonzero(lengths == length))
            for length in np.unique(lengths[lengths > 0])
        ]


def _find_stop(span: tuple[range, Integers]) -> int:
    """Return the frame behind an occlusion."""
    return span[0].stop


class ClipSummary:
    """Summary of a clip, updated block by block, in order.

    Attributes
    ----------
    skipped : dict
        The reason for each skipped frame, by its number in the clip.
    digests : list of bytes
        SHA-256 of the file of each frame.
    peaks : DeviationPeaks
        The largest |v̂ − v| of each vertex; of no vertices before the first block.
    occlusions : OcclusionTracker, optional
        How long vertices had no data; None if all have data in all frames.
    """

    def __init__(self) -> None:
        self.skipped: dict[int, Said] = {}
        self.digests: list[bytes] = []
        self.peaks = DeviationPeaks.none(0)
        self._squared_errors = np.zeros(())
        self.occlusions: OcclusionTracker | None = None
        self._kept_counts: Integers | None = None
        self._rms: list[Floats] = []
        self._bound = VertexBoundAccumulator()

    def update(self, block: SolvedBlock) -> None:
        """Add the next block."""
        self.skipped |= block.skipped
        self.peaks = self.peaks.merge(block.peaks) if self.frames_done else block.peaks
        self.digests += block.digests
        self._squared_errors = self._squared_errors + block.squared_errors
        if block.kept is not None:
            before = 0 if self._kept_counts is None else self._kept_counts
            self._kept_counts = before + block.kept.counts
            self.occlusions = self.occlusions or OcclusionTracker(len(block.kept.counts))
            self.occlusions.update(block.kept, range(block.start, block.stop), block.skipped)
        self._rms.append(block.metrics.rms)
        self._bound.update(block.sampled)

    def set_bridged(self, frames: int) -> None:
        """State over how many frames motion tells where occluded vertices are, at most."""
        if self.occlusions is not None:
            self.occlusions.bridged = frames

    @property
    def frames_done(self) -> int:
        """Return the number of frames so far."""
        return len(self.digests)

    @property
    def vertex_rms(self) -> Floats:
        """Return sqrt(mean |v̂ − v|²), (m,), over solved frames; nan for missing data.

        The mean is over the frames in which a vertex was kept, if that differs.
        """
        if self._kept_counts is not None:
            counts = np.where(self._kept_counts > 0, self._kept_counts, np.nan)
            return np.sqrt(self._squared_errors / counts)
        return np.sqrt(self._squared_errors / max(1, self.frames_done - len(self.skipped)))

    def measure_bound(self, points: int) -> VertexBound | None:
        """Return the error of the best possible cage animation of a cage of `points` vertices.

        None without sampled displacements.
        """
        return self._bound.finish(points, self.frames_done - len(self.skipped))

    @property
    def frame_rms(self) -> Floats:
        """Return the rms of each frame, (F,); nan for skipped ones."""
        return np.concatenate(self._rms)

    def find_key_frames(self, is_rest: NDArray[np.bool_] | None = None) -> Integers:
        """Return the numbers of the worst, the median and the best frame by rms, (3,) int64.

        The best is none of those that are the rest pose, `is_rest` (F,), if there are others.
        """
        ranked = np.argsort(self.frame_rms, kind="stable")
        ranked = ranked[: self.frames_done - len(self.skipped)]
        if not len(ranked):
            return ranked
        others = ranked if is_rest is None else ranked[~is_rest[ranked]]
        best = others[0] if len(others) else ranked[0]
        return np.array([ranked[-1], ranked[(len(ranked) - 1) // 2], best])


def summarize_blocks(blocks: Iterable[SolvedBlock]) -> ClipSummary:
    """Summarise all blocks of a clip."""
    summary = ClipSummary()
    for block in blocks:
        summary.update(block)
    return summary
