"""Templates of pages of one file each: nothing is fetched, and only our own script runs."""

import base64
import hashlib
import re
from dataclasses import dataclass
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from cageik_cli import __version__

_environment = Environment(
    loader=PackageLoader("cageik_cli.report.html"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)


@dataclass(frozen=True, slots=True, eq=False)
class PlayerPart:
    """What a page that has a player is handed of it.

    Attributes
    ----------
    values : dict
        What the template of its section shows.
    scripts : tuple of str
        Texts of its scripts, in the order in which they use each other.
    """

    values: dict[str, Any]
    scripts: tuple[str, ...]


def render_template(template: str, *, player: PlayerPart | None = None, **values: Any) -> str:
    """Render a page from a template and its values.

    All values are escaped. The page's security policy allows only the script of this digest. With
    a player it has its scripts and its style, too.
    """
    styles = ["style.css", *(["player.css"] if player else [])]
    script = _join_scripts(player.scripts if player else ())
    return _environment.get_template(template).render(
        style="".join(map(_read_template, styles)),
        script=script,
        script_digest=_compute_policy_digest(script),
        generator=f"cageik {__version__}",
        player=player.values if player else None,
        **values,
    )


@cache
def _join_scripts(player_scripts: tuple[str, ...]) -> str:
    """Return the script of a page with these scripts of the player; all pages share it."""
    return "".join([_read_template("script.js"), *map(shorten_script, player_scripts)])


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


def format_ticks(top: float, bottom: float = 0.0) -> list[str]:
    """Format evenly spaced numbers from `bottom` to `top`, for the foot of a colour scale."""
    count = 5  # numbers that have room below a scale
    numbers = [bottom + (top - bottom) * k / (count - 1) for k in range(count)]
    return [f"{number:.4g}".replace("-", "\N{MINUS SIGN}") for number in numbers]


def shorten_script(script: str) -> str:
    """Return a script without comments and without spaces that have no meaning.

    Only for our own scripts, which keep to what is known here: a comment, also one of types in
    `/** */`, has a line of its own, a statement ends with a semicolon or a brace and is not empty,
    and a text in backquotes has none within it. Texts are not changed, except that the code of a
    shader, which is a text that begins with its version, is shortened, too.
    """
    code = re.sub(r"^\s*(?://|/\*\*).*\n", "", script, flags=re.MULTILINE)
    texts = r"""("(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*'|`(?:\\.|[^`\\])*`)"""
    parts = re.split(texts, code)
    for k in range(0, len(parts), 2):
        parts[k] = _shorten_code(parts[k])
    parts = _join_definitions(parts)
    for k in range(1, len(parts), 2):
        if parts[k].startswith("`#version"):
            version, _, body = parts[k].partition("\n")
            body = re.sub(r"\b0(?=\.[1-9])|(?<=\d\.)0\b", "", body)
            parts[k] = f"{version}\n{_drop_spaces(body)}"
        else:
            parts[k] = re.sub(r"\$\{[^{}\"'`]*\}", lambda code: _shorten_code(code[0]), parts[k])
    return "".join(parts) + "\n"


def _join_definitions(parts: list[str]) -> list[str]:
    """Make one definition of those that follow each other; every second part is a text."""
    defines = [False]  # whether the statement does so, in each of the brackets around it

    def shorten(found: re.Match[str]) -> str:
        sign = found[0]
        if sign in "([{":
            defines.append(False)
        elif sign in ")]}":
            defines.pop()
        else:
            is_joined = sign.startswith(";let") and defines[-1]
            defines[-1] = "let" in sign
            return "," if is_joined else sign
        return sign

    joined = [re.sub(r"[][(){}]|;let\b ?|;|\blet\b", shorten, code) for code in parts[::2]]
    return [part for pair in zip(joined, [*parts[1::2], ""], strict=True) for part in pair][:-1]


def _shorten_code(code: str) -> str:
    """Drop spaces, and write what is often in code in fewer letters."""
    words = {"true": "!0", "false": "!1", "undefined": "void 0", "Infinity": "1/0"}
    for word, short in words.items():
        # Not a factor: what is short for Infinity is a fraction.
        code = re.sub(rf"(?<![*/%.] )\b{word}\b(?! \*)", short, code)
    code = _drop_spaces(code)
    shorter = {
        r"[;,]\}": "}",
        # What cannot be assigned to is not assigned to either if it can be.
        r"\bconst\b": "let",
        r"(?<!async)\((\w+)\)=>": r"\1=>",
        r"\b0\.(?=\d)": ".",
    }
    for wordy, short in shorter.items():
        code = re.sub(wordy, short, code)
    return code


def _drop_spaces(code: str) -> str:
    """Drop spaces unless they are between two words, or between signs that would be another one."""
    parts = re.split(r"(\s+)", code.strip())
    for k in range(1, len(parts), 2):
        before, after = parts[k - 1][-1], parts[k + 1][0]
        is_word = all(sign.isalnum() or sign in "_$" for sign in (before, after))
        parts[k] = " " if is_word or (before == after and before in "+-") else ""
    return "".join(parts)
