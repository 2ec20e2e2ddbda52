"""How a film is made, and within which limits."""

import math
import re
from dataclasses import dataclass
from typing import Self

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

FILM_SUFFIXES = (".webp", ".gif", ".mp4", ".webm", ".png")
"""Of the names of films; those of the last are pictures in a folder."""

HALF_VIEW = 15.0
"""Degrees from the middle of a picture to its nearer edges, as in the player."""

MIN_VIEW_DISTANCE, MAX_VIEW_DISTANCE = 0.02, 50.0
"""Of a camera from what it looks at, in diagonals, as in the player."""

MAX_VIEW_PLACE = 1e4
"""Largest coordinate of what a camera looks at, in diagonals."""


@dataclass(frozen=True, slots=True)
class FilmView:
    """From where a film is seen.

    Attributes
    ----------
    turn, tilt : float
        Degrees to the right of the front, and above it.
    distance : float, optional
        Of the camera from what it looks at, diagonals of the rest model; without it the projection
        is parallel, and all that the film shows is in the picture.
    place : (float, float, float)
        What it looks at: diagonals from the middle of the rest cage.
    follows : bool
        Whether it goes with the model.
    """

    turn: float
    tilt: float
    distance: float | None = None
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    follows: bool = False

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse `TURN,TILT`, or all that the player copies: `TURN,TILT,DISTANCE,X,Y,Z[,follow]`.

        Raises
        ------
        SettingError
            When it is neither, or a number is out of its range.
        """
        number = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d{1,3})?"
        form = rf"({number}),({number})(?:,({number}),({number}),({number}),({number})(,follow)?)?"
        found = re.fullmatch(form, re.sub(r"\s+", "", text.lower()), re.ASCII)
        if found is None:
            raise SettingError(
                Hint("film_view", text)
                + ": is no view (expected degrees to the right of the front "
                "and above it, such as 32,14, or what Copy view of the player copies)"
            )
        turn, tilt, *others = [float(word) for word in found.groups()[:6] if word is not None]
        least, most = MIN_VIEW_DISTANCE, MAX_VIEW_DISTANCE
        ranges = [(turn, -360.0, 360.0, "turn"), (tilt, -90.0, 90.0, "tilt")]
        if others:
            ranges.append((others[0], least, most, "distance"))
            ranges += [(x, -MAX_VIEW_PLACE, MAX_VIEW_PLACE, "coordinate") for x in others[1:]]
        for value, low, high, name in ranges:
            if not (math.isfinite(value) and low <= value <= high):
                raise SettingError(
                    Hint("film_view", text) + f": the {name} {value:g} is out of range (expected "
                    f"{low:g} to {high:g}); choose another"
                )
        if not others:
            return cls(turn, tilt)
        distance, x, y, z = others
        return cls(turn, tilt, distance, (x, y, z), found[7] is not None)


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
    film_view : str, optional
        From where the film is seen, as of `FilmView`.
    film_no_cage : bool
        Whether the model is drawn alone.
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

    film_view: str | None = declare_setting(
        None,
        "From where: degrees right of the front and above, or what Copy view of the player copies.",
        unset="32,14",
        metavar="VIEW",
        group=HelpGroup.WRITTEN,
    )
    film_no_cage: bool = declare_setting(
        False, "Draw the model without its cage.", group=HelpGroup.WRITTEN
    )

    def __post_init__(self) -> None:
        check_settings(self)
        if self.film_view is not None:
            FilmView.parse(self.film_view)
        width, height = self.film_size
        if not all(MIN_FILM_SIDE <= side <= MAX_FILM_SIDE for side in self.film_size):
            raise SettingError(
                Hint("film_size", f"{width}x{height}")
                + f": a side is out of range (expected {MIN_FILM_SIDE} "
                f"to {MAX_FILM_SIDE} pixels); choose another size"
            )

    @property
    def view(self) -> FilmView | None:
        """The view that is asked for."""
        return None if self.film_view is None else FilmView.parse(self.film_view)
