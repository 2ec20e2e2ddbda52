"""How the command's pages of text look."""

from collections.abc import Iterable


def page(headline: str, rows: Iterable[tuple[str, str]]) -> str:
    """A headline and labelled lines under it."""
    return "\n".join([headline, *map(row, rows)])


def row(labelled: tuple[str, str]) -> str:
    """One labelled line."""
    label, text = labelled
    return f"  {label:<14} {text}"
