"""What the figure over the frames shows: the error, and what is drawn beside it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cageik_cli.report.record import Report
from cageik_cli.report.vocabulary import wording_of
from cageik_cli.util.arrays import Floats

LEAST = 0.001
"""Percent: no axis ends lower, so that rounding is not made to look like error."""

LARGEST = 1e150
"""A line leaves the picture here; no axis could be drawn."""


@dataclass(frozen=True, slots=True)
class Look:
    """How a line looks, in matplotlib's words."""

    colour: str
    style: str | tuple[int, tuple[float, ...]]
    marker: str


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """A line over the frames: its figures, and how it looks.

    Attributes
    ----------
    values : (F,) float64
        In percent; nan in gaps.
    name : str
        With the unit, behind a comma.
    metrics : tuple of str
        Limits on these are drawn with it.
    side : int
        Of its axis: 0 for left, 1 for right.
    look : Look
    """

    values: Floats
    name: str
    metrics: tuple[str, ...]
    side: int
    look: Look

    @property
    def is_signed(self) -> bool:
        """Whether limits hold on both sides of zero."""
        return self.metrics == ("volume_change",)


def series_of(report: Report) -> tuple[Series, Series]:
    """The error, and the change of volume or the largest deviation.

    The latter is taken where the model is open, or no frame has a volume.
    """
    frames, words = report.frames, wording_of(report.edited_from)
    error = Series(
        _values([frame.rms_percent for frame in frames]),
        f"RMS {words.measure}, % of the diagonal",
        ("rms", "frame_rms"),
        0,
        Look("#0a7d4b", "-", "o"),
    )
    changes = [frame.volume_change for frame in frames]
    if report.clip.closed and any(change is not None for change in changes):
        look = Look("#1f4fa3", (0, (3.4, 1.1)), "s")
        return error, Series(_values(changes), "volume change, %", ("volume_change",), 1, look)
    deviations = _values([frame.max_deviation_percent for frame in frames])
    name = f"{words.largest}, % of the diagonal"
    look = Look("#8a3a8f", (0, (4, 1, 1, 1)), "^")
    return error, Series(deviations, name, ("max_deviation",), 1, look)


def _values(figures: Sequence[float | None]) -> Floats:
    values = np.array([np.nan if figure is None else figure for figure in figures])
    return np.asarray(np.clip(values, -LARGEST, LARGEST))
