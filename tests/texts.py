"""What is said, as text."""

from collections.abc import Iterable


def texts(said: Iterable[object]) -> tuple[str, ...]:
    """Return notes, or other texts, as the Python API shows them."""
    return tuple(map(str, said))
