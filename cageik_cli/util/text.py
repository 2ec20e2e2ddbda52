"""How the command's texts look."""

from collections.abc import Iterable
from pathlib import Path


def page(headline: str, rows: Iterable[tuple[str, str]]) -> str:
    """A headline and labelled lines under it."""
    return "\n".join([headline, *map(row, rows)])


def row(labelled: tuple[str, str]) -> str:
    """One labelled line."""
    label, text = labelled
    return f"  {label:<14} {text}"


def printable(name: str | Path) -> str:
    """A name as Unicode text; what in it is none (bytes that are not UTF-8) is replaced."""
    return str(name).encode("utf-16", "surrogatepass").decode("utf-16", "replace")


def shown(text: str) -> str:
    """Text on one line, for files of any kind: what has no glyph of its own is replaced."""
    return "".join(
        " " if mark.isspace() else mark if mark.isprintable() else "\ufffd" for mark in text
    )


def bytes_text(count: int) -> str:
    """A number of bytes, to three digits in the unit that suits it."""
    units = ("bytes", "kB", "MB", "GB", "TB")
    step = next(k for k in range(len(units)) if count < 999.5 * 1000**k or k == len(units) - 1)
    return f"{count / 1000**step:.3g} {units[step]}"
