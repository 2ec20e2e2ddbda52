"""Read, run and compare the console blocks of a page.

A block is a list of steps: a line `$ cageik ...` and the output that is shown below it. A line
`...` stands for any number of lines. What differs from machine to machine is masked.
"""

import glob
import re
import shlex
from dataclasses import dataclass

from click.testing import CliRunner

from cageik_cli.cli import main

ELLIPSIS = "..."
SHOWN_FOLDER = "/projects/walk"
"""What stands in the pages for the temporary folder in which a block runs."""

_SECONDS = re.compile(r"^(\s+seconds\s).*$")
_SPENT = re.compile(r"\b\d+(\.\d+)? s\b")
_CACHE = re.compile(r"^\s+cache\s")
_ROUNDING = re.compile(r"-?\b\d+(\.\d+)?e-(0[89]|[1-9]\d)\b")


@dataclass(frozen=True)
class Step:
    """A command of a console block, as it is typed, and the output shown for it."""

    typed: tuple[str, ...]
    shown: tuple[str, ...]

    @property
    def words(self):
        """The words of the command, globs expanded."""
        line = " ".join(line.removesuffix("\\").strip() for line in self.typed)
        line = line.removeprefix("$").strip()
        words = []
        for word in _split(line):
            if word[0] in "'\"":
                words.append(word[1:-1])
            elif set(word) & set("*?["):
                words += sorted(glob.glob(word)) or [word]
            else:
                words.append(word)
        return words


def _split(line):
    lexer = shlex.shlex(line, posix=False)
    lexer.whitespace_split = True
    lexer.commenters = ""  # a `#` within a word is part of it, as in cage_####.obj
    words = list(lexer)
    return words[: words.index("#")] if "#" in words else words


def read_steps(text):
    """Return the steps of a console block.

    Raises
    ------
    ValueError
        When output stands before the first command.
    """
    steps, lines = [], text.splitlines()
    while lines:
        typed = [lines.pop(0)]
        if not typed[0].startswith("$ "):
            raise ValueError(f"output without a command: {typed[0]!r}")
        while typed[-1].endswith("\\"):
            typed.append(lines.pop(0))
        shown = []
        while lines and not lines[0].startswith("$ "):
            shown.append(lines.pop(0))
        steps.append(Step(tuple(typed), tuple(_strip_end(shown))))
    return steps


def run_step(step, folder, cache):
    """Run a step in the current folder, and return its exit code and its lines."""
    words = step.words
    if words[0] != "cageik":
        raise ValueError(f"console blocks run cageik only, not {words[0]!r}; use a block of sh")
    variables = {"CAGEIK_CACHE": str(cache), "GITHUB_STEP_SUMMARY": None, "COLUMNS": "80"}
    runner = CliRunner(env=variables)
    outcome = runner.invoke(main, words[1:], prog_name="cageik", catch_exceptions=False)
    text = outcome.output.replace(str(folder.resolve()), SHOWN_FOLDER)
    return outcome.exit_code, _strip_end(text.replace(str(folder), SHOWN_FOLDER).splitlines())


def mask(line):
    """Return a line without what differs from run to run and from machine to machine."""
    line = _SECONDS.sub(r"\1#", line.rstrip())
    return _SPENT.sub("# s", _ROUNDING.sub("~0", line))


def mask_all(lines):
    """Return masked lines, without the one that tells whether weights came from the cache."""
    return [mask(line) for line in lines if not _CACHE.match(line)]


def find_mismatch(shown, found):
    """Return the first shown line that the found lines do not have, or None if all fits."""
    shown, found = mask_all(shown), mask_all(found)
    start = 0
    parts = _split_at_ellipses(shown)
    for k, part in enumerate(parts):
        first, last = k == 0, k == len(parts) - 1
        if last and not first:
            places = [len(found) - len(part)]
        else:
            places = [start] if first else range(start, len(found) - len(part) + 1)
        place = next((p for p in places if p >= start and found[p : p + len(part)] == part), None)
        if place is None:
            return _first_difference(part, found[start:], anchored=first)
        start = place + len(part)
    if len(parts) == 1 and start < len(found):
        return f"(end of the block; the command goes on with {found[start]!r})"
    return None


def _split_at_ellipses(lines):
    parts = [[]]
    for line in lines:
        if line.strip() == ELLIPSIS:
            parts.append([])
        else:
            parts[-1].append(line)
    return parts


def _first_difference(part, found, anchored):
    if anchored:
        pairs = zip(part, [*found, *[None] * len(part)], strict=False)
        return next((line for line, other in pairs if line != other), part[0])
    return next((line for line in part if line not in found), part[0] if part else "(end)")


def _strip_end(lines):
    lines = list(lines)
    while lines and not lines[-1].strip():
        lines.pop()
    return lines
