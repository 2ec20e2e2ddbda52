"""Read the pages and their code blocks."""

import re
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from markdown_it import MarkdownIt

ROOT = Path(__file__).resolve().parents[2]
_MARK = re.compile(r"<!--\s*(not run|skip|setup|exit|save|file)(?::\s*(.*?))?\s*-->", re.DOTALL)


@dataclass(frozen=True)
class Block:
    """A fenced code block of a page.

    Attributes
    ----------
    page : str
        The name of the page, relative to the project.
    line : int
        The line of the opening fence, from 1.
    language, text : str
        The word after the fence, and what stands between the fences.
    marks : dict
        The HTML comments before the fence: `not run`, `skip`, `setup`, `exit`, `save`, `file`.
    nested : bool
        Whether the block stands in a list or a quotation.
    """

    page: str
    line: int
    language: str
    text: str
    marks: dict[str, str] = field(default_factory=dict)
    nested: bool = False

    def __str__(self):
        return f"{self.page}:{self.line}"


def find_pages():
    """Return the README, the other documents at the top, and every page of the site."""
    top = [ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")]
    return [path for path in top if path.exists()] + sorted((ROOT / "docs").rglob("*.md"))


def name_page(path):
    """Return the name of a page, relative to the project where it is part of it."""
    return str(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else path.name


def read_blocks(path):
    """Return the fenced blocks of a page, in its order."""
    blocks, marks = [], {}
    for token in MarkdownIt("commonmark").parse(path.read_text(encoding="utf-8")):
        if token.type == "html_block":
            marks |= dict(_MARK.findall(token.content))
        elif token.type == "fence":
            language = token.info.strip()
            blocks.append(
                Block(
                    name_page(path),
                    token.map[0] + 1,
                    language,
                    token.content,
                    marks,
                    token.level > 0,
                )
            )
            marks = {}
        elif token.type != "html_block" and token.nesting != -1:
            marks = {}
    return blocks


def read_all_blocks(language=None):
    """Return the blocks of all pages, or those of one language."""
    return [block for block in _read_all_pages() if language in (None, block.language)]


@cache
def _read_all_pages():
    return [block for path in find_pages() for block in read_blocks(path)]


def read_prose(path):
    """Return the text of a page without its fenced blocks and comments."""
    text = re.sub(r"^ *```.*?^ *```$", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    return re.sub(r"<!--.*?-->", "", text, flags=re.S)
