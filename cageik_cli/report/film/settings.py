"""How a film is made, and within which limits."""

from dataclasses import dataclass

from cageik_cli.util.errors import SettingError

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

    film_size: tuple[int, int] = (640, 480)
    film_seconds: float | None = None
    film_turntable: bool = False
    film_follow: bool = False

    def __post_init__(self) -> None:
        width, height = self.film_size
        if not all(MIN_FILM_SIDE <= side <= MAX_FILM_SIDE for side in self.film_size):
            raise SettingError(
                f"`film_size={width}x{height}`: a side is out of range (expected {MIN_FILM_SIDE} "
                f"to {MAX_FILM_SIDE} pixels); choose another size"
            )
        seconds = self.film_seconds
        if seconds is not None and not MIN_FILM_SECONDS <= seconds <= MAX_FILM_SECONDS:
            raise SettingError(
                f"`film_seconds={seconds:g}`: is out of range (expected {MIN_FILM_SECONDS:g} to "
                f"{MAX_FILM_SECONDS:g} seconds); choose another length"
            )
        if self.film_turntable and self.film_follow:
            raise SettingError(
                "`film_follow=True`: a turn around the rest pose has no motion to follow; leave "
                "out this or `film_turntable=True`"
            )
