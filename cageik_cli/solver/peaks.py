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
        """Find the peaks of the frames with these numbers.

        Parameters
        ----------
        squared_errors : (k, m) float64
            |v̂ − v|²; nan in all frames for vertices without data.
        frames : (k,) int64
        """
        squares = np.zeros(squared_errors.shape[1])
        found = np.full(len(squares), -1)
        for row, frame in zip(squared_errors, frames, strict=True):
            is_larger = row > squares  # not where it is nan
            np.copyto(squares, row, where=is_larger)
            np.copyto(found, frame, where=is_larger)
        return DeviationPeaks(np.sqrt(squares), found)

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
