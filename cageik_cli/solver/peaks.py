"""The largest deviation of each vertex over the frames of a clip, and where it was."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.util.arrays import Floats, Integers


@dataclass(frozen=True, slots=True, eq=False)
class DeviationPeaks:
    """The largest deviation of each vertex over some frames.

    Peaks of blocks of frames, merged in order, are those of all their frames at once.

    Attributes
    ----------
    deviations : (m,) float64
        max |v̂ − v|, file units; 0 for vertices without data.
    frames : (m,) int64
        The first frame in which it was; −1 where no frame deviates.
    """

    deviations: Floats
    frames: Integers

    @staticmethod
    def of_frames(squared_errors: Floats, frames: Integers) -> "DeviationPeaks":
        """Find the peaks of the frames with these numbers: |v̂ − v|², (k, m), nan for no data."""
        if not len(frames):
            return DeviationPeaks.none(squared_errors.shape[1])
        best = np.nan_to_num(squared_errors, nan=-1.0).argmax(axis=0)
        squares = np.take_along_axis(squared_errors, best[None], axis=0)[0]
        deviations = np.sqrt(np.nan_to_num(squares))
        return DeviationPeaks(deviations, np.where(deviations > 0, frames[best], -1))

    @staticmethod
    def none(vertex_count: int) -> "DeviationPeaks":
        """Return the peaks of no frame."""
        return DeviationPeaks(np.zeros(vertex_count), np.full(vertex_count, -1))

    def merge(self, later: "DeviationPeaks") -> "DeviationPeaks":
        """Return the peaks of these frames and of later ones; the first of equal ones counts."""
        is_later = later.deviations > self.deviations
        return DeviationPeaks(
            np.where(is_later, later.deviations, self.deviations),
            np.where(is_later, later.frames, self.frames),
        )
