"""What is said, as text."""

from collections.abc import Iterable

from cageik_cli.report.views.cage import CheckResult, format_check_headline, list_check_rows
from cageik_cli.util.text import format_block


def texts(said: Iterable[object]) -> tuple[str, ...]:
    """Return notes, or other texts, as the Python API shows them."""
    return tuple(map(str, said))


def format_check_text(result: CheckResult) -> str:
    """Return all that `check -v` prints of a cage, in the words of Python."""
    return format_block(format_check_headline(result), list_check_rows(result))
