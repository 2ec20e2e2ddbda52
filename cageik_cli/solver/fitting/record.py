"""What is recorded of a fit beside the weights: its settings, its clips and how good it is."""

from dataclasses import dataclass

from cageik_cli.solver.fitting.held_out import Comparison
from cageik_cli.solver.settings import FitSettings, SolveSettings
from cageik_cli.util.errors import SettingError

MAX_HELD_OUT_RATIO = 2.0
"""Held-out errors that are more times the error of the fitted frames are warned of."""

MIN_STATED_PERCENT = 1e-3
"""Errors below this percentage of the diagonal are rounding; ratios of them say nothing."""

MAX_UNSEEN_SHARE = 0.98
"""If the held-out error is a larger share of that of the unfitted weights, the fit gains nothing
on other motion."""

MAX_ROUGHNESS = 3.0
"""Weights that are more times as rough as the unfitted ones are warned of."""

MAX_COPIED_SHARE = 0.5
"""If more of the held-out frames are copies of fitted ones, their error says nothing."""


@dataclass(frozen=True, slots=True)
class FitReport:
    """What fitted weights gain, and what they cost.

    Attributes
    ----------
    regularization, smoothness : float
        λ and μ.
    frames : int
        Frames of all clips.
    fitted_frames : int
        Frames of the sample that the weights were fitted to.
    needed_memory : int or None
        Bytes that a larger sample needs; None if memory did not limit it.
    fitted : Comparison
        On these frames.
    held_out_blocks : Comparison or None
        Weights fitted to every other of `HELD_OUT_BLOCKS` blocks of consecutive frames of each
        clip, measured on the blocks between them; None if the clips are too short.
    copied_frames : int
        Held-out frames that are nearer to a fitted frame than `fitted.fitted.rms`, and much
        nearer than the motion is large: weights that fit the one fit the other, whatever they are
        elsewhere.
    unseen_third : Comparison or None
        Weights fitted to the first two thirds of each clip, measured on the last.
    negative_per_row : float
        Mean over vertices of the sum of a row's negative weights, as a positive number.
    min_weight : float
        The smallest weight.
    roughness : float
        The norm of ΛW relative to that of the binding's own weights.
    fixed_floats : int
        Numbers that must be stored with the cage animation.
    curve : tuple of (float, float)
        Regularizations tried and their errors on held-out blocks, rms in percent of the diagonal.
    """

    regularization: float
    smoothness: float
    frames: int
    fitted_frames: int
    needed_memory: int | None
    fitted: Comparison
    held_out_blocks: Comparison | None
    copied_frames: int
    unseen_third: Comparison | None
    negative_per_row: float
    min_weight: float
    roughness: float
    fixed_floats: int
    curve: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        counts = {
            "frames": self.frames,
            "fitted_frames": self.fitted_frames,
            "copied_frames": self.copied_frames,
            "fixed_floats": self.fixed_floats,
            "needed_memory": self.needed_memory or 0,
        }
        costs = {"negative_per_row": self.negative_per_row, "roughness": self.roughness}
        for name, value in (counts | costs).items():
            if value < 0:
                raise SettingError(f"{name} is {value}, expected zero or above")

    @property
    def is_overfitted(self) -> bool:
        """Return whether the error of held-out frames is far above that of the fitted ones."""
        held_out = self.held_out_blocks
        if held_out is None:
            return False
        largest = max(MAX_HELD_OUT_RATIO * self.fitted.fitted.rms, MIN_STATED_PERCENT)
        return held_out.fitted.rms > largest

    @property
    def is_gainless(self) -> bool:
        """Return whether held-out frames are followed hardly better than without the fit."""
        held_out = self.held_out_blocks
        if held_out is None or held_out.unfitted.rms < MIN_STATED_PERCENT:
            return False
        return held_out.fitted.rms > MAX_UNSEEN_SHARE * held_out.unfitted.rms

    @property
    def is_repetitive(self) -> bool:
        """Return whether most of the held-out frames are copies of fitted ones."""
        held_out = self.held_out_blocks
        return held_out is not None and self.copied_frames > MAX_COPIED_SHARE * held_out.frames


@dataclass(frozen=True, slots=True)
class FittedClip:
    """A clip that weights were fitted to.

    Attributes
    ----------
    name : str
        Of its file, or of its first and last file.
    sha256 : str
        The digest of its files.
    """

    name: str
    sha256: str
    frames: int

    def __post_init__(self) -> None:
        if self.frames < 1:
            raise SettingError(f"frames is {self.frames}, expected 1 or more")


@dataclass(frozen=True, slots=True)
class FitRecord:
    """The record of a fit.

    Attributes
    ----------
    settings : FitSettings
        As they were asked for.
    solve : SolveSettings
        Of the cages that the weights were fitted with.
    """

    settings: FitSettings
    solve: SolveSettings
    clips: tuple[FittedClip, ...]
    report: FitReport
