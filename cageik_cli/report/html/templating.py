"""Templates of pages of one file each: nothing is fetched, and only our own script runs."""

import base64
import hashlib
from dataclasses import dataclass
from functools import partial
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from cageik_cli.formats.timeline import format_frame_number
from cageik_cli.report.figures import (
    format_change,
    format_length,
    format_metric,
    format_percent,
)
from cageik_cli.util.text import format_count, group_digits
from cageik_cli.util.version import __version__


@dataclass(frozen=True, slots=True, eq=False)
class PlayerPart:
    """A player, as a page is handed it.

    Attributes
    ----------
    section : Markup
        Its section of the page.
    style : str
        What it adds to the style of the page.
    script : str
        What it adds to the script of the page.
    """

    section: Markup
    style: str
    script: str


THIN_SPACE = "\u202f"
"""Between groups of digits on a page: narrow, and no place to break a line."""

FORMATS = {
    "change": format_change,
    "count": partial(format_count, group=THIN_SPACE),
    "digits": partial(group_digits, group=THIN_SPACE),
    "metric": format_metric,
    "number": format_frame_number,
    "percent": format_percent,
    "units": partial(format_length, group=THIN_SPACE),
}
"""How templates format figures."""


class Templates:
    """The templates of some packages; of two with one name, that of the first package counts.

    All values are escaped, and one that is missing is an error.
    """

    def __init__(self, *packages: str) -> None:
        self._environment = Environment(
            loader=ChoiceLoader([PackageLoader(package) for package in packages]),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
            keep_trailing_newline=True,
        )
        self._environment.globals |= FORMATS

    def render(self, template: str, **values: Any) -> Markup:
        """Render a part of a page."""
        return Markup(self._environment.get_template(template).render(**values))

    def render_page(self, template: str, *, player: PlayerPart | None = None, **values: Any) -> str:
        """Render a page, with the player that it is handed.

        The page's security policy allows only the script of this digest.
        """
        script = self.read("script.js") + (player.script if player else "")
        digest = hashlib.sha256(script.encode()).digest()
        return self._environment.get_template(template).render(
            style=self.read("style.css") + (player.style if player else ""),
            script=script,
            # In the notation of a content security policy.
            script_digest=f"sha256-{base64.b64encode(digest).decode()}",
            generator=f"cageik {__version__}",
            player=player,
            **values,
        )

    def read(self, name: str) -> str:
        """Read a file of the templates' folders; it holds no text of users."""
        assert self._environment.loader is not None
        return self._environment.loader.get_source(self._environment, name)[0]


REPORT_TEMPLATES = Templates("cageik_cli.report.html")


def make_data_url(content: bytes, kind: str) -> str:
    """Encode a picture as a data URL; `kind` is the part of its MIME type after `image/`."""
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def make_png_url(picture: bytes) -> str:
    """Encode a PNG file as a data URL."""
    return make_data_url(picture, "png")


def format_ticks(top: float, bottom: float = 0.0) -> list[str]:
    """Format evenly spaced numbers from `bottom` to `top`, for the foot of a colour scale."""
    count = 5  # numbers that have room below a scale
    numbers = [bottom + (top - bottom) * k / (count - 1) for k in range(count)]
    return [f"{number:.4g}".replace("-", "\N{MINUS SIGN}") for number in numbers]
