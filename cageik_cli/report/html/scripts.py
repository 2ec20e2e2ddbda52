"""Scripts without what only their readers need: comments, indents, and spaces between signs.

Only for our own scripts, which keep to what `shorten_script` knows: a comment has a line of its
own, a statement ends with a semicolon or a brace, and a text in backquotes has none within it.
"""

import re

_COMMENTS = re.compile(r"^\s*//.*\n", re.MULTILINE)

_PARTS = re.compile(
    r"""(?P<text> `\#version.*\n | "(?:\\.|[^"\\])*" | '(?:\\.|[^'\\])*' | `(?:\\.|[^`\\])*`)
      | (?P<space> \s+)
      | [^\s"'`]+""",
    re.VERBOSE,
)

_SIGNS_BEFORE_LINES, _SIGNS_AFTER_LINES = "{([;,=:?&|>", "})].?:&|"
"""Between these and the end of a line no statement ends."""


def shorten_script(script: str) -> str:
    """Return a script without comments and without spaces that have no meaning.

    Texts are not changed, except that the code of a shader, which is a text that begins with its
    version, is shortened, too. A line stays a line where it may end a statement.
    """
    code = _COMMENTS.sub("", script).strip()
    out: list[str] = []
    for part in _PARTS.finditer(code):
        if part["space"]:
            before, after = code[part.start() - 1], code[part.end()]
            out.append(_shorten_space(part["space"], before, after))
        else:
            out.append(part[0])
    return "".join(out) + "\n"


def _shorten_space(space: str, before: str, after: str) -> str:
    if "\n" in space and before not in _SIGNS_BEFORE_LINES and after not in _SIGNS_AFTER_LINES:
        return "\n"
    is_word = all(sign.isalnum() or sign in "_$" for sign in (before, after))
    return " " if is_word or (before == after and before in "+-") else ""
