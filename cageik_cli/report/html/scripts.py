"""Scripts without what only their readers need: comments, indents, and spaces between signs.

Only for our own scripts, which keep to what `shorten_script` knows: a comment has a line of its
own, a statement ends with a semicolon or a brace and is not empty, and a text in backquotes has
none within it.
"""

import re

_COMMENTS = re.compile(r"^\s*//.*\n", re.MULTILINE)

_CONSTANTS = re.compile(r"(?:^ *const [^;\n]*;\n){2,}", re.MULTILINE)
"""Lines that each define constants, and do nothing else."""

_TEXTS = re.compile(r"""("(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*'|`(?:\\.|[^`\\])*`)""")

_SHADER_START = "`#version"

_SPACES = re.compile(r"(\s+)")

_SHORTER = (
    (re.compile(r"[;,]\}"), "}"),
    # What cannot be assigned to is not assigned to either if it can be.
    (re.compile(r"\bconst\b"), "let"),
    (re.compile(r"(?<!async)\((\w+)\)=>"), r"\1=>"),
    (re.compile(r"\btrue\b"), "!0"),
    (re.compile(r"\bfalse\b"), "!1"),
    (re.compile(r"\b0\.(?=\d)"), "."),
)


def shorten_script(script: str) -> str:
    """Return a script without comments and without spaces that have no meaning.

    Texts are not changed, except that the code of a shader, which is a text that begins with its
    version, is shortened, too.
    """
    joined = _CONSTANTS.sub(_join_constants, _COMMENTS.sub("", script))
    parts = _TEXTS.split(joined)
    for k in range(0, len(parts), 2):
        parts[k] = _drop_spaces(parts[k])
        for wordy, short in _SHORTER:
            parts[k] = wordy.sub(short, parts[k])
    for k in range(1, len(parts), 2):
        if parts[k].startswith(_SHADER_START):
            version, _, body = parts[k].partition("\n")
            parts[k] = f"{version}\n{_drop_spaces(body)}"
    return "".join(parts) + "\n"


def _join_constants(lines: re.Match[str]) -> str:
    """Return several definitions of constants as one."""
    return re.sub(r";\n *const ", ",\n", lines[0])


def _drop_spaces(code: str) -> str:
    """Drop spaces unless they are between two words, or between signs that would be another one."""
    parts = _SPACES.split(code.strip())
    for k in range(1, len(parts), 2):
        before, after = parts[k - 1][-1], parts[k + 1][0]
        is_word = all(sign.isalnum() or sign in "_$" for sign in (before, after))
        parts[k] = " " if is_word or (before == after and before in "+-") else ""
    return "".join(parts)
