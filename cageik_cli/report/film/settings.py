"""How a film is made, and within which limits."""

from dataclasses import dataclass

from cageik_cli.util.errors import SettingError
from cageik_cli.util.messages import Hint
from cageik_cli.util.settings import HelpGroup, check_settings, declare_setting

MIN_FILM_SIDE, MAX_FILM_SIDE = 64, 1920
"""Pixels of the width and of the height of a film."""

MIN_FILM_SECONDS, MAX_FILM_SECONDS = 0.1, 120.0
"""Length of a film."""

DEFAULT_TURN_SECONDS = 6.0
"""Length of a turn around the model: details are seen, and nobody waits."""

MAX_FILM_RATE = 30.0
"""Pictures per second; of faster clips, every second frame or fewer are shown."""

TURN_RATE = 24.0
"""Pictures per second of a turn."""


@dataclass(frozen=True, slots=True)
class FilmSettings:
    """How a film is made.

    Attributes
    ----------
    film_size : (int, int)
        Width and height, pixels.
    film_seconds : float, optional
        Of the clip, that many seconds from its start, and all if absent; of a turn, its length.
    film_turntable : bool
        Whether the camera goes around the rest pose, in place of playing the clip.
    film_follow : bool
        Whether the camera goes with the model; else it stays where it sees all frames.
    """

    film_size: tuple[int, int] = declare_setting(
        (640, 480),
        "Width and height of the film, pixels.",
        kind="picture size",
        typed="640x480",
        group=HelpGroup.WRITTEN,
    )
    film_seconds: float | None = declare_setting(
        None,
        "Length of the film: from the start of the clip, or of a turn.",
        unset=f"all, or {DEFAULT_TURN_SECONDS:g}",
        minimum=MIN_FILM_SECONDS,
        maximum=MAX_FILM_SECONDS,
        refusal="`film_seconds={value:g}`: is out of range (expected "
        f"{MIN_FILM_SECONDS:g} to {MAX_FILM_SECONDS:g} seconds); choose another length",
        group=HelpGroup.WRITTEN,
    )
    film_turntable: bool = declare_setting(
        False,
        "Go around the rest pose, in place of playing the clip.",
        group=HelpGroup.WRITTEN,
    )
    film_follow: bool = declare_setting(
        False,
        "Let the camera go with the model.",
        excludes=(
            (
                "film_turntable",
                "`film_follow=True`: a turn around the rest pose has no motion to follow; leave "
                "out this or `film_turntable=True`",
            ),
        ),
        group=HelpGroup.WRITTEN,
    )

    def __post_init__(self) -> None:
        check_settings(self)
        width, height = self.film_size
        if not all(MIN_FILM_SIDE <= side <= MAX_FILM_SIDE for side in self.film_size):
            raise SettingError(
                Hint("film_size", f"{width}x{height}")
                + f": a side is out of range (expected {MIN_FILM_SIDE} "
                f"to {MAX_FILM_SIDE} pixels); choose another size"
            )
