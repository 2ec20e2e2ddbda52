"""Pages of one file each: everything is inside, nothing is fetched, and only our script runs."""

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
    """A page from a template and what it shows.

    All values are escaped. The page's own policy lets no script run but the one of its digest.
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
    """A picture as the address of itself; `kind` is what comes after `image/`."""
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def _read_template(name: str) -> str:
    """The text of a file of the templates' folder, which holds no user's text."""
    assert _environment.loader is not None
    return _environment.loader.get_source(_environment, name)[0]


def _compute_policy_digest(script: str) -> str:
    """A script's digest as a content security policy writes it."""
    return "sha256-" + base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
