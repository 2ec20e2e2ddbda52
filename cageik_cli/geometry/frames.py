"""The frames of a clip, as numerics take them."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import InputError, MissingFrameError


class FrameSource(Protocol):
    """A clip whose frames can be read more than once, each by its number from 0."""

    @property
    def missing(self) -> frozenset[int]:
        """Frames that cannot be read, because they were never there."""

    def __len__(self) -> int:
        """Return the number of frames."""

    def read_frame(self, index: int) -> Floats:
        """Read the vertices of a frame, (m, 3); raise an `InputError` if that fails."""

    def location(self, index: int) -> str:
        """Say where a frame comes from, for messages."""

    def digest_or_zeros(self, index: int) -> bytes:
        """Return the SHA-256 of what a frame was read from; zeros if it cannot be read."""


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Consecutive frames of a clip.

    Attributes
    ----------
    start : int
        Number of the first.
    positions : (k, m, 3) float64
        The clip's first frame stands in for one that could not be read, so that the results of the
        others do not depend on it.
    read_errors : dict
        By number in the clip, why a frame could not be read.
    """

    start: int
    positions: Floats
    read_errors: dict[int, InputError]

    @property
    def stop(self) -> int:
        """Number of the frame after the last."""
        return self.start + len(self.positions)

    @property
    def gaps(self) -> Integers:
        """Places in the block of the frames that could not be read, ascending."""
        return np.array(sorted(self.read_errors), np.int64) - self.start

    def raise_read_errors(self, ignore_missing: bool = False) -> None:
        """Raise the first of the errors, if there is one; perhaps not those of missing frames."""
        for _, error in sorted(self.read_errors.items()):
            if not (ignore_missing and isinstance(error, MissingFrameError)):
                raise error
