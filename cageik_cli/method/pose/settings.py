"""Settings of edits and their defaults. This module imports no numerics."""

from dataclasses import dataclass
from math import isfinite

from cageik_cli.util.errors import SettingError
from cageik_cli.util.messages import Hint
from cageik_cli.util.settings import HelpGroup, check_settings, declare_setting

DEFAULT_POSE_ALPHA = 1e-6
"""Much smaller than in `DualLaplacianSolver`: a few anchors should be met closely."""

DEFAULT_SNAP = "2%"
"""How far a position may be from the surface if it may be, and no number is given."""

MAX_WEIGHT_RATIO = 1e100
"""Largest ratio of alpha to beta; numbers overflow far beyond it."""


def validate_weights(alpha: float, beta: float) -> None:
    """Check the weights of the Laplacian and of the anchors."""
    for name, value in (("alpha", alpha), ("beta", beta)):
        if not (isfinite(value) and value > 0):
            raise SettingError(Hint(name) + f" is {value}, expected a finite number above 0")
    if alpha / MAX_WEIGHT_RATIO > beta:
        raise SettingError(
            Hint("alpha")
            + f" is {alpha}, expected at most {MAX_WEIGHT_RATIO:g} times beta, which is {beta}; "
            "make alpha smaller"
        )


@dataclass(frozen=True, slots=True)
class PosingSettings:
    """How handles move a cage.

    Alpha and beta are as in `Poser`; `snap`, `allow_conflicts` and `hard` are those of
    `place_handles`. The mirror is about the plane of the cage; a handles file that states a plane
    keeps that.
    """

    alpha: float = declare_setting(
        DEFAULT_POSE_ALPHA,
        "Weight of the cage's Laplacian: higher is smoother, and meets handles less exactly.",
        name="pose_alpha",
        meaning="weight of the cage's Laplacian in the edit",
        option="--alpha",
        group=HelpGroup.SOLVE,
    )
    beta: float = declare_setting(
        1.0,
        "Weight of the handles.",
        name="pose_beta",
        meaning="weight of the handles",
        option="--beta",
        group=HelpGroup.SOLVE,
    )
    rigidity: int = declare_setting(
        0,
        "Rounds in which parts of the cage rotate with the motion; 0 shears them.",
        name="rigidity",
        meaning="rounds that rotate parts of the cage with the edit",
        minimum=0,
        group=HelpGroup.SOLVE,
    )
    hard: bool = declare_setting(
        False,
        "Meet all handles exactly.",
        name="hard",
        meaning="meet all handles exactly",
        group=HelpGroup.SOLVE,
    )
    hold: bool = declare_setting(
        True,
        "Leave the model as it is outside the radii of the handles; else all of it follows them.",
        name="hold",
        meaning="the model stays outside the radii of the handles",
        option="--hold/--no-hold",
        group=HelpGroup.SOLVE,
    )
    radius: float | None = declare_setting(
        None,
        "How far over the surface the model moves with handles that state no radius, in the "
        "model's units; chosen from the model if absent.",
        name="radius",
        meaning="how far over the surface the model moves with handles, file units",
        is_recorded_unset=False,
        above=0,
        excludes=(
            ("hold", "`radius=` needs a rest that is held; leave it out, or use `hold=True`"),
        ),
        group=HelpGroup.SOLVE,
    )
    mirror: bool = declare_setting(
        False,
        "Mirror the edit to the other side, about the plane of a symmetric cage.",
        name="mirror",
        meaning="both sides of the cage move as mirror images",
        is_recorded_unset=False,
        group=HelpGroup.SOLVE,
    )
    snap: float | None = declare_setting(
        None,
        "Move handles with a position to the nearest point of the surface, if it is at "
        f"most this far away; {DEFAULT_SNAP} of the diagonal if no number is given.",
        name="snap",
        meaning="how far positions of handles may be from the surface, percent of the diagonal",
        kind="snap",
        metavar="NUMBER[%]",
        bare=DEFAULT_SNAP,
        minimum=0,
        group=HelpGroup.SOLVE,
    )
    allow_conflicts: bool = declare_setting(
        False,
        "Take the mean if one point has different targets.",
        name="allow_conflicts",
        meaning="use the mean when handles at one point have different targets",
        group=HelpGroup.SOLVE,
    )

    def __post_init__(self) -> None:
        check_settings(self)
        validate_weights(self.alpha, self.beta)
