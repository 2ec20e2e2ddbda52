"""The settings of a fit, and what is recorded of it beside the weights: clips, and how good it is.

This module imports no numerics.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, NamedTuple, get_args

from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.util.errors import SettingError
from cageik_cli.util.settings import HelpGroup, check_settings, declare_setting

FIT_VERSION = 5
"""Raise it when fitted weights or their reports change, so that caches are not used."""

MAX_EDIT_ROUGHNESS = 1.15
"""Edits of the cage may be this many times as rough as with the weights before, if no strength is
given and they are not only played."""

MIN_DISTINCT_FRAMES = 30
"""Of fewer poses, frames kept aside say little about other motion: weights stay smooth."""

MAX_HELD_OUT_BLOCKS = 10
"""Each clip is cut into so many blocks of consecutive frames; every second one is held out."""

MAX_HELD_OUT_RATIO = 2.0
"""Held-out errors that are more times the error of the fitted frames are warned of."""

MIN_STATED_PERCENT = 1e-3
"""Errors below this percentage of the diagonal are rounding; ratios of them say nothing."""

MAX_GAINLESS_SHARE = 0.98
"""A fit gains nothing on other motion if it leaves more of the unfitted weights' held-out error."""

MAX_COPIED_SHARE = 0.5
"""If more of the held-out frames are copies of fitted ones, their error says nothing."""

MAX_ROUGHNESS = 3.0
"""Weights that are more times as rough as the unfitted ones are warned of."""

Use = Literal["edit", "play"]
"""What fitted weights are for."""


class Strength(NamedTuple):
    """How strongly a fit is pulled to the weights before.

    `regularization` is λ, the pull itself; `smoothness` is μ, that of the change over the surface.
    """

    regularization: float
    smoothness: float


DEFAULT_STRENGTH = Strength(0.1, 1.0)
"""Where a strength is neither given nor chosen by measurement."""


class StrengthLimit(StrEnum):
    """Why a fit has its strength: what a weaker one would have done worse, or ruled out."""

    GIVEN = "given"
    FRAMES = "few frames"
    NONE_ASIDE = "none kept aside"
    MEMORY = "memory"
    INFLUENCES = "few influences"
    EDITS = "edits"
    KEPT_ASIDE = "kept aside"
    GAIN = "no gain"
    LADDER = "weakest"


@dataclass(frozen=True, slots=True)
class FitSettings:
    """Settings of weights that are fitted to clips: a field of it is all that an option needs.

    Attributes
    ----------
    regularization : float or None
        λ, the pull to the binding's own weights, above 0; None chooses it by measurement.
    smoothness : float or None
        μ, the smoothness over the surface of the change of the weights, 0 or above; None chooses
        it, too, or is that of `DEFAULT_STRENGTH` where λ is given.
    use : {"edit", "play"}
        Whether what is chosen keeps edits of the cage smooth, or only follows the frames.
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
    >>> FitSettings(regularization=0.01).strength
    Strength(regularization=0.01, smoothness=1.0)
    >>> FitSettings().strength is None
    True
    """

    regularization: float | None = declare_setting(
        None,
        "Pull of fitted weights to the others: higher is smoother and less exact; auto chooses it, "
        "by frames kept aside from the fit and by how smooth edits stay.",
        name="fit_regularization",
        meaning="pull of fitted weights to the others",
        word="auto",
        unset="auto",
        expected="a number, such as 0.1",
        metavar="NUMBER|AUTO",
        above=0,
        group=HelpGroup.FIT,
    )
    smoothness: float | None = declare_setting(
        None,
        "Smoothness over the surface of what the fit changes; auto chooses it with the pull, and "
        f"is {DEFAULT_STRENGTH.smoothness:g} where that is given.",
        name="fit_smoothness",
        meaning="smoothness over the surface of what a fit changes in the weights",
        word="auto",
        unset="auto",
        expected="a number, such as 1",
        metavar="NUMBER|AUTO",
        minimum=0,
        group=HelpGroup.FIT,
    )
    use: Use = declare_setting(
        "edit",
        f"What the weights are for: edit keeps edits of the cage at most {MAX_EDIT_ROUGHNESS:g} "
        "times as rough as with the weights before; play only follows the frames.",
        name="fit_for",
        meaning="what fitted weights are for",
        choices=get_args(Use),
        group=HelpGroup.FIT,
        excludes=(
            (
                "regularization",
                "the fit is for {use}, but its regularization is {regularization}, which leaves "
                "nothing to choose: leave one out",
            ),
        ),
    )
    rank: int | None = declare_setting(
        None,
        "Rank of what the fit changes: few numbers to store beside weights that can be computed.",
        name="fit_rank",
        meaning="rank of what a fit changes in the weights; none is any",
        unset="any",
        minimum=1,
        refusal="`rank=` is {value}, expected 1 or more",
        group=HelpGroup.FIT,
        excludes=(
            (
                "influences",
                "fit rank is {rank} and influences are {influences}; a fit has one of them: leave "
                "one out",
            ),
        ),
    )
    influences: int | None = declare_setting(
        None,
        "Cage vertices that move each vertex, with weights that are not negative, as skeletons "
        "need.",
        name="influences",
        meaning="cage vertices that move each vertex, at most; none is all",
        unset="all",
        minimum=1,
        refusal="`influences=` is {value}, expected 1 or more",
        group=HelpGroup.FIT,
    )

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def strength(self) -> Strength | None:
        """The strength that is given; None if it is chosen, in part or as a whole."""
        if self.regularization is None:
            return None
        given = DEFAULT_STRENGTH.smoothness if self.smoothness is None else self.smoothness
        return Strength(self.regularization, given)


@dataclass(frozen=True, slots=True)
class EditRoughness:
    """How rough edits of the cage are with fitted weights, relative to those before the fit.

    The mean over edits of the norm of the surface's Laplacian of the displacements, relative to
    that with the weights before.

    Attributes
    ----------
    smooth : float
        Of edits that move a third of the cage about a vertex.
    local : float
        Of edits that move a sixth.
    """

    smooth: float
    local: float

    def __post_init__(self) -> None:
        for name in ("smooth", "local"):
            if not getattr(self, name) >= 0:
                raise SettingError(f"{name} is {getattr(self, name)}, expected zero or above")

    @property
    def largest(self) -> float:
        """The larger of both."""
        return max(self.smooth, self.local)


@dataclass(frozen=True, slots=True)
class TriedStrength:
    """A strength that was tried: the errors of frames held out, and how rough edits are.

    Attributes
    ----------
    regularization, smoothness : float
        λ and μ.
    held_out_blocks : float
        The rms on the blocks held out, in percent of the diagonal.
    last_third : float or None
        That on the last third of each clip, of weights fitted to the first two.
    edits : EditRoughness
        Of the weights fitted to the other blocks.
    """

    regularization: float
    smoothness: float
    held_out_blocks: float
    last_third: float | None
    edits: EditRoughness


@dataclass(frozen=True, slots=True)
class Distances:
    """Distances of reconstructions from frames, in percent of the rest pose's diagonal.

    Attributes
    ----------
    rms : float
        Root mean square over vertices and frames; a frame of the sample counts as many times as
        there are frames it stands for.
    percentile : float
        99th percentile over the vertices of the frames that those of the sample stand for.
    largest : float
        Largest over the vertices of the sample's frames.
    """

    rms: float
    percentile: float
    largest: float

    def __post_init__(self) -> None:
        for name in ("rms", "percentile", "largest"):
            if not getattr(self, name) >= 0:
                raise SettingError(f"{name} is {getattr(self, name)}, expected zero or above")


@dataclass(frozen=True, slots=True)
class Comparison:
    """The errors of fitted weights, and of the weights they were fitted from, on the same frames.

    Attributes
    ----------
    fitted, unfitted : Distances
        With the fitted weights; with those before.
    frames : int
        How many frames of the sample were measured.
    """

    fitted: Distances
    unfitted: Distances
    frames: int

    def __post_init__(self) -> None:
        if self.frames < 1:
            raise SettingError(f"frames is {self.frames}, expected 1 or more")


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
        Weights fitted to every other of `MAX_HELD_OUT_BLOCKS` blocks of consecutive frames of each
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
    limit : StrengthLimit
        Why the strength is what it is.
    ladder : tuple of TriedStrength
        The strengths tried, the strongest first; none if it was not chosen.
    edits : EditRoughness or None
        Of the fitted weights; None in files of an older version.
    distinct_frames : int or None
        How many frames of the sample differ; None in files of an older version.
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
    limit: StrengthLimit = StrengthLimit.GIVEN
    ladder: tuple[TriedStrength, ...] = ()
    edits: EditRoughness | None = None
    distinct_frames: int | None = None

    def __post_init__(self) -> None:
        counts = {
            "frames": self.frames,
            "fitted_frames": self.fitted_frames,
            "copied_frames": self.copied_frames,
            "fixed_floats": self.fixed_floats,
            "needed_memory": self.needed_memory or 0,
            "distinct_frames": self.distinct_frames or 0,
        }
        costs = {"negative_per_row": self.negative_per_row, "roughness": self.roughness}
        for name, value in (counts | costs).items():
            if value < 0:
                raise SettingError(f"{name} is {value}, expected zero or above")

    @property
    def is_overfitted(self) -> bool:
        """Return whether the error of held-out frames is far above that of the fitted ones.

        It is not if the strength was chosen by these frames: a stronger fit follows them worse.
        """
        held_out = self.held_out_blocks
        if held_out is None or self.ladder:
            return False
        largest = max(MAX_HELD_OUT_RATIO * self.fitted.fitted.rms, MIN_STATED_PERCENT)
        return held_out.fitted.rms > largest

    @property
    def is_gainless(self) -> bool:
        """Return whether held-out frames are followed hardly better than without the fit."""
        held_out = self.held_out_blocks
        if held_out is None or held_out.unfitted.rms < MIN_STATED_PERCENT:
            return False
        return held_out.fitted.rms > MAX_GAINLESS_SHARE * held_out.unfitted.rms

    @property
    def is_repetitive(self) -> bool:
        """Return whether most held-out frames are copies of fitted ones; their error is empty."""
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
        The digest of its files, hexadecimal.
    frames : int
        How many it has.
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
        Those of the cages.
    clips : tuple of FittedClip
        The clips that the weights were fitted to.
    report : FitReport
        What the weights gain, and what they cost.
    """

    settings: FitSettings
    solve: SolveSettings
    clips: tuple[FittedClip, ...]
    report: FitReport
