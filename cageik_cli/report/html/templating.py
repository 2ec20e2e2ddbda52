"""Templates of pages of one file each: nothing is fetched, and only our own script runs."""

import base64
import hashlib
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from cageik_cli import __version__

GENERATOR = f"cageik {__version__}"

_environment = Environment(
    loader=PackageLoader("cageik_cli.report.html"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)


def render_template(template: str, **values: Any) -> str:
    """Render a page from a template and its values.

    All values are escaped. The page's security policy allows only the script of this digest.
    """
    script = _read_template("script.js")
    return _environment.get_template(template).render(
        style=_read_template("style.css"),
        script=script,
        script_digest=_compute_policy_digest(script),
        generator=GENERATOR,
        **values,
    )


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
