"""Text for people: labelled rows, numbers of things, sizes, and names as Unicode."""

import re
from collections.abc import Iterable
from pathlib import Path

from cageik_cli.util.messages import Row, spell

RESERVED_NAMES = {
    "CON",
    "PRN",
    "AUX",
    "NUL",
    *(f"{port}{k}" for port in ("COM", "LPT") for k in range(10)),
}
"""Names that no file may have on Windows, whatever its suffix."""


def format_block(headline: str, rows: Iterable[Row]) -> str:
    """Return a headline with labelled lines under it."""
    return "\n".join([single_line(headline), *map(format_row, rows)])


def format_row(labelled_text: Row) -> str:
    """Return one labelled line."""
    label, text = labelled_text
    return single_line(f"  {label:<14} {spell(text)}")


def to_unicode(name: str | Path) -> str:
    """Return a name as valid Unicode; bytes that are not UTF-8 are replaced."""
    return str(name).encode("utf-16", "surrogatepass").decode("utf-16", "replace")


def single_line(text: str) -> str:
    """Return text on one line; characters that cannot be printed are replaced."""
    return make_printable("".join(" " if mark.isspace() else mark for mark in text), allowed="")


def make_printable(text: str, allowed: str = "\n\r\t") -> str:
    """Return text whose characters are all printed, or `allowed`; others become U+FFFD.

    What is replaced are control characters, with which a terminal begins commands, marks that
    change the direction of the text after them, and halves of pairs.
    """
    if text.isprintable():
        return text
    return "".join(
        mark
        if mark.isprintable() or mark in allowed or (mark.isspace() and mark > "\x9f")
        else "\ufffd"
        for mark in text
    )


def pluralize(noun: str) -> str:
    """Return the plural of a noun; of words such as "pair of faces", that of the first."""
    first, of, rest = noun.partition(" of ")
    return ("vertices" if first == "vertex" else f"{first}s") + of + rest


def group_digits(number: int | str, group: str = " ") -> str:
    """Return a number, or the text of one, with the digits before its point in groups of three."""
    whole, rest = re.fullmatch(r"(-?\d*)(.*)", str(number)).groups()  # type: ignore[union-attr]
    return re.sub(r"(?<=\d)(?=(\d{3})+$)", group, whole) + rest


def format_count(count: int, noun: str, group: str = " ") -> str:
    """Format a number of things: "1 frame", "2 frames", "2 400 vertices"."""
    return f"{group_digits(count, group)} {noun if count == 1 else pluralize(noun)}"


def format_decimals(value: float, decimals: int) -> str:
    """Format a number with some decimals, and a small one with two digits: only 0 is read as 0."""
    text = f"{value:.{decimals}f}"
    return f"{value:.2g}" if value and float(text) == 0 else text


def format_bytes(count: int) -> str:
    """Return a number of bytes with three digits and a unit."""
    units = ("bytes", "kB", "MB", "GB", "TB")
    step = next(k for k in range(len(units)) if count < 999.5 * 1000**k or k == len(units) - 1)
    return f"{count / 1000**step:.3g} {units[step]}"


def make_file_name(name: str) -> str:
    """Return a name that is safe as a part of a path on all systems."""
    text = "".join("_" if c in '/\\:*?"<>|' else c for c in single_line(to_unicode(name)))
    text = text.strip(". ") or "_"
    return f"_{text}" if text.split(".")[0].upper() in RESERVED_NAMES else text


def number_file_names(names: Iterable[str]) -> list[str]:
    """Return names of files that are all different, also where capitals do not count."""
    plain = list(names)
    folded = [name.casefold() for name in plain]
    unique = zip(plain, folded, number_names(folded), strict=True)
    return [name + numbered[len(fold) :] for name, fold, numbered in unique]


def number_names(names: Iterable[str], taken: Iterable[str] = ()) -> list[str]:
    """Return names that are all different: one that is taken, or there before, gets a number."""
    known, numbers, chosen = set(taken), dict[str, int](), list[str]()
    for name in names:
        unique = name
        while unique in known:
            # Numbers go on, for many names may be alike.
            numbers[name] = numbers.get(name, 1) + 1
            unique = f"{name}_{numbers[name]}"
        known.add(unique)
        chosen.append(unique)
    return chosen
