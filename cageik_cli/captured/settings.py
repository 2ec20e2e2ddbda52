"""What is done for clips from scanners and trackers. This module imports no numerics."""

from dataclasses import dataclass
from typing import Final, Literal

from cageik_cli.util.errors import SettingError
from cageik_cli.util.messages import Hint
from cageik_cli.util.settings import HelpGroup, check_settings, declare_setting

AUTO_SMOOTHING: Final = "auto"
"""As the period that is smoothed: found by generalised cross-validation."""

MAX_SMOOTHING_PERIOD = 240
"""Longest period that is smoothed, in frames; the shortest is any above 0.

The condition number of the solve over time grows with the fourth power of the period: at 240 frames
rounding moves the cages by 1e-7 of the model's size, at 1000 by 1e-5, and at 10⁴ by a tenth.
"""


@dataclass(frozen=True, slots=True)
class CaptureSettings:
    """What is done for clips from scanners and trackers; nothing by default.

    Vertices that are far from where the cage can have them count less, or not at all. Smoothing
    halves motions with its period, in seconds; quicker ones nearly vanish, and what turns steadily
    stays.
    """

    robust: bool = declare_setting(
        False,
        "Reject vertices that are outliers in some frames.",
        name="robust",
        meaning="reject vertices that are outliers in some frames",
        is_recorded_unset=False,
        group=HelpGroup.CAPTURED,
    )
    smooth: float | Literal["auto"] | None = declare_setting(
        None,
        "Smooth the cages over time: halve motions of this period, or find it from the noise.",
        name="smooth",
        meaning="period in seconds of motions that are smoothed away by half",
        is_recorded_unset=False,
        word=AUTO_SMOOTHING,
        expected="a number of seconds",
        metavar=f"SECONDS|{AUTO_SMOOTHING}",
        above=0,
        refusal="`smooth=` is {value}, expected seconds above 0, or auto",
        group=HelpGroup.CAPTURED,
    )
    fill_gaps: bool = declare_setting(
        False,
        "Fill frames without data from those around them.",
        name="fill_gaps",
        meaning="fill frames without data from those around them",
        is_recorded_unset=False,
        group=HelpGroup.CAPTURED,
    )

    def __post_init__(self) -> None:
        check_settings(self)

    def check_period(self, fps: float) -> None:
        """Refuse to smooth periods of more than `MAX_SMOOTHING_PERIOD` frames."""
        period = self.smooth
        if isinstance(period, float | int) and period * fps > MAX_SMOOTHING_PERIOD:
            raise SettingError(
                Hint("smooth") + f" is {period:.6g} seconds, expected at most "
                f"{MAX_SMOOTHING_PERIOD / fps:.4g} ({MAX_SMOOTHING_PERIOD} frames at {fps:g} per "
                "second); state a shorter period"
            )

    @property
    def needs_time_pass(self) -> bool:
        """Whether frames are smoothed or filled over time, after they are solved."""
        return self.smooth is not None or self.fill_gaps
