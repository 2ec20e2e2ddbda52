"""What is printed: no character of a file's name or content controls the terminal."""

import codecs
import io
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from cageik_cli.util.text import make_printable


class PrintableStream:
    """A text stream that replaces control characters; it hands all else to another stream.

    Bytes that are written to its `buffer`, such as a picture, are left as they are.
    """

    def __init__(self, stream: io.TextIOWrapper) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write text."""
        if not isinstance(text, str):
            raise TypeError(f"expected text, not {type(text).__name__}")
        self._stream.write(make_printable(text))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def printable_streams() -> Iterator[None]:
    """Make the standard streams printable in the block."""
    streams = sys.stdout, sys.stderr
    try:
        sys.stdout, sys.stderr = map(_make_printable_stream, streams)
        yield
    finally:
        sys.stdout, sys.stderr = streams


def _make_printable_stream(stream: Any) -> Any:
    """Return a stream that replaces control characters; None for one that was closed."""
    if not isinstance(stream, io.TextIOWrapper):
        return stream
    # click would write past us to a stream of ASCII, which it takes for misconfigured.
    is_ascii = codecs.lookup(stream.encoding).name == "ascii"
    # File names may have any bytes.
    stream.reconfigure(encoding="utf-8" if is_ascii else None, errors="backslashreplace")
    return PrintableStream(stream)
