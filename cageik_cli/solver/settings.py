"""Settings of the solver and their defaults. This module imports no numerics."""

from dataclasses import dataclass
from math import isfinite
from typing import Final, Literal

from cageik_cli.util.errors import SettingError


@dataclass(frozen=True, slots=True)
class SolveSettings:
    """Settings of the minimisation.

    Attributes
    ----------
    alpha, beta : float
        Weights of the Laplacian and of the vertices; finite, not negative, not both zero.
    align : bool
        Align every frame rigidly with the rest pose, solve there, and move the cage back.
    """

    alpha: float = 1e-3
    beta: float = 1.0
    align: bool = True

    def __post_init__(self) -> None:
        for name, value in (("alpha", self.alpha), ("beta", self.beta)):
            if not (isfinite(value) and value >= 0):
                raise SettingError(f"{name} is {value}, expected a finite number, zero or above")
        if self.alpha == self.beta == 0:
            raise SettingError("alpha and beta are both 0, expected at least one above 0")


AREA = "area"
"""Says, in place of a file of vertex weights, that each vertex counts by its area."""

AUTO_SMOOTHING: Final = "auto"
"""As the period that is smoothed: found by generalised cross-validation."""

MAX_SMOOTHED_FRAMES = 240
"""Longest period that is smoothed, in frames: far longer ones have no solution in double
precision."""


@dataclass(frozen=True, slots=True)
class CaptureSettings:
    """What is done for clips from scanners and trackers; nothing by default.

    Attributes
    ----------
    robust : bool
        Let vertices that are far from where the cage can have them count less, or not at all.
    smooth : float or "auto", optional
        Smooth the cages over time: motions of the whole mesh with this period, in seconds, are
        halved, and quicker ones nearly vanish. Not smoothed by default.
    fill_gaps : bool
        Fill frames that are skipped, or have no data, from those around them in time.

    Raises
    ------
    SettingError
        When the period is not above 0.
    """

    robust: bool = False
    smooth: float | Literal["auto"] | None = None
    fill_gaps: bool = False

    def __post_init__(self) -> None:
        period = self.smooth
        if isinstance(period, float | int) and not (isfinite(period) and period > 0):
            raise SettingError(f"smooth is {period}, expected seconds above 0, or auto")

    def check_period(self, fps: float) -> None:
        """Refuse a period of more frames than the windows of long clips can smooth.

        Raises
        ------
        InputError
            With the longest period at this number of frames per second.
        """
        period = self.smooth
        if isinstance(period, float | int) and period * fps > MAX_SMOOTHED_FRAMES:
            raise SettingError(
                f"smooth is {period:.6g} seconds, expected at most {MAX_SMOOTHED_FRAMES / fps:.4g} "
                f"({MAX_SMOOTHED_FRAMES} frames at {fps:g} per second); state a shorter period"
            )

    @property
    def needs_time_pass(self) -> bool:
        """Whether frames are smoothed or filled over time, after they are solved."""
        return self.smooth is not None or self.fill_gaps


FIT_VERSION = 2
"""Raise it when fitted weights or their reports change, so that caches are not used."""

DEFAULT_REGULARIZATION = 0.1
DEFAULT_SMOOTHNESS = 1.0


@dataclass(frozen=True, slots=True)
class FitSettings:
    """Settings of weights that are fitted to clips.

    Attributes
    ----------
    regularization : float or None
        λ, the pull to the binding's own weights, above 0; None chooses it by frames held out.
    smoothness : float
        μ, the smoothness over the surface of the change of the weights, 0 or above.
    rank : int, optional
        Rank of the change of the weights; any by default.
    influences : int, optional
        Cage vertices per vertex, with weights that are not negative; all by default.

    Raises
    ------
    SettingError
        When a value is out of its range, or both a rank and influences are given.

    Examples
    --------
    >>> from cageik_cli import FitSettings
    >>> FitSettings(rank=10)
    FitSettings(regularization=0.1, smoothness=1.0, rank=10, influences=None)
    """

    regularization: float | None = DEFAULT_REGULARIZATION
    smoothness: float = DEFAULT_SMOOTHNESS
    rank: int | None = None
    influences: int | None = None

    def __post_init__(self) -> None:
        value = self.regularization
        if value is not None and not (isfinite(value) and value > 0):
            raise SettingError(f"fit regularization is {value}, expected a finite number above 0")
        if not (isfinite(self.smoothness) and self.smoothness >= 0):
            raise SettingError(
                f"fit smoothness is {self.smoothness}, expected a finite number, zero or above"
            )
        for name in ("rank", "influences"):
            count = getattr(self, name)
            if count is not None and count < 1:
                raise SettingError(f"fit {name} is {count}, expected 1 or more")
        if self.rank is not None and self.influences is not None:
            raise SettingError(
                f"fit rank is {self.rank} and influences are {self.influences}; a fit has one of "
                "them: leave one out"
            )
