"""The scripts of the player: read and shortened, so that a page stays small."""

import re
from functools import cache
from importlib.resources import files

PLAYER_SCRIPTS = (
    "payload",
    "algebra",
    "skin",
    "clip",
    "colours",
    "camera",
    "renderer",
    "pointers",
    "selection",
    "transform",
    "transport",
    "stage",
    "before",
    "controls",
    "panel",
    "modes",
    "timeline",
    "axes",
    "parts",
    "response",
    "hold",
    "poser",
    "tracks",
    "document",
    "cage_edits",
    "editor",
    "handles",
    "cage_mode",
    "influence",
    "edit_meter",
    "start",
)
"""Scripts of the player, in the order in which they use each other."""


@cache
def read_scripts(names: tuple[str, ...]) -> str:
    """Read scripts of the player by their names, shortened and joined."""
    folder = files("cageik_cli.view") / "templates" / "player"
    return "".join(shorten_script((folder / f"{name}.js").read_text("utf-8")) for name in names)


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
