"""How the command's texts look."""

from collections.abc import Iterable
from pathlib import Path


def format_block(headline: str, rows: Iterable[tuple[str, str]]) -> str:
    """A headline and labelled lines under it."""
    return "\n".join([headline, *map(format_row, rows)])


def format_row(labelled_text: tuple[str, str]) -> str:
    """One labelled line."""
    label, text = labelled_text
    return f"  {label:<14} {text}"


def to_unicode(name: str | Path) -> str:
    """A name as Unicode text; what in it is none (bytes that are not UTF-8) is replaced."""
    return str(name).encode("utf-16", "surrogatepass").decode("utf-16", "replace")


def single_line(text: str) -> str:
    """Text on one line, for files of any kind: what has no glyph of its own is replaced."""
    return "".join(
        " " if mark.isspace() else mark if mark.isprintable() else "\ufffd" for mark in text
    )


def format_bytes(count: int) -> str:
    """A number of bytes, to three digits in the unit that suits it."""
    units = ("bytes", "kB", "MB", "GB", "TB")
    step = next(k for k in range(len(units)) if count < 999.5 * 1000**k or k == len(units) - 1)
    return f"{count / 1000**step:.3g} {units[step]}"
