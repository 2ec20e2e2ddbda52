"""Templates of pages of one file each: nothing is fetched, and only our own script runs."""

import base64
import hashlib
from collections.abc import Sequence
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from cageik_cli import __version__
from cageik_cli.report.html.scripts import shorten_script

GENERATOR = f"cageik {__version__}"

_environment = Environment(
    loader=PackageLoader("cageik_cli.report.html"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)


PLAYER_SCRIPTS = (
    "payload",
    "algebra",
    "skin",
    "clip",
    "colours",
    "camera",
    "renderer",
    "pointers",
    "transport",
    "stage",
    "controls",
    "response",
    "poser",
    "tracks",
    "document",
    "editor",
    "handles",
    "start",
)
"""Scripts of the player, in the order in which they use each other."""

VIEW_SCRIPTS = (*PLAYER_SCRIPTS[:-1], "apply", PLAYER_SCRIPTS[-1])
"""Those of the player in a page that a program serves, and that may send it handles."""


def render_template(template: str, *, player_scripts: Sequence[str] = (), **values: Any) -> str:
    """Render a page from a template and its values.

    All values are escaped. The page's security policy allows only the script of this digest.

    Parameters
    ----------
    player_scripts : sequence of str
        Names of scripts of the player that the page has, too, with its style.
    **values
        Of the template.
    """
    styles = ["style.css"]
    script = _join_scripts(tuple(player_scripts))
    if player_scripts:
        styles.append("player.css")
    return _environment.get_template(template).render(
        style="".join(map(_read_template, styles)),
        script=script,
        script_digest=_compute_policy_digest(script),
        generator=GENERATOR,
        **values,
    )


@cache
def _join_scripts(player_scripts: tuple[str, ...]) -> str:
    """Return the script of a page with these scripts of the player; all pages share it."""
    names = [f"player/{name}.js" for name in player_scripts]
    shortened = [shorten_script(_read_template(name)) for name in names]
    return "".join([_read_template("script.js"), *shortened])


def make_data_url(content: bytes, kind: str) -> str:
    """Encode a picture as a data URL; `kind` is the part of its MIME type after `image/`."""
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def make_png_url(picture: bytes) -> str:
    """Encode a PNG file as a data URL."""
    return make_data_url(picture, "png")


def _read_template(name: str) -> str:
    """Read a file of the templates' folder; it holds no text of users."""
    assert _environment.loader is not None
    return _environment.loader.get_source(_environment, name)[0]


def _compute_policy_digest(script: str) -> str:
    """Compute a script's digest in the notation of a content security policy."""
    return "sha256-" + base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
