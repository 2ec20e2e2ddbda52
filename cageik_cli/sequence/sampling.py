"""Which of a clip's samples are its frames, and what they say of the scene's time."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.util.arrays import Floats

EVEN = 1e-4
"""Steps that differ by more than this part of their mean are not even."""


@dataclass(frozen=True, slots=True, eq=False)
class Sampling:
    """When the frames of a clip are.

    Attributes
    ----------
    times : (F,)
        Ascending, seconds or time codes.
    step : float or None
        From one to the next; None for one alone, or when steps differ.
    """

    times: Floats
    step: float | None

    @staticmethod
    def of(times: set[float]) -> "Sampling":
        """Frames at `times`; one at time 0 if there are none."""
        ordered = np.array(sorted(times or {0.0}))
        steps = np.diff(ordered)
        if len(steps) == 0:
            return Sampling(ordered, None)
        mean = float(ordered[-1] - ordered[0]) / len(steps)
        even = bool((np.abs(steps - mean) <= EVEN * mean).all())
        return Sampling(ordered, mean if even else None)

    @property
    def is_uneven(self) -> bool:
        """Whether steps differ."""
        return self.step is None and len(self.times) > 1


def rate(step: float) -> float:
    """Frames a second of seconds a frame, without the last digits, which are rounding's."""
    return round(1 / step, 9)
