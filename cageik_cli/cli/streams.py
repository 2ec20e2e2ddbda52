"""What is printed: no character of a file's name or content controls the terminal."""

import codecs
import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from cageik_cli.util.text import make_printable


class PrintableStream:
    """A text stream that replaces control characters; it hands all else to another stream.

    Bytes that are written to its `buffer`, such as a picture, are left as they are.

    Parameters
    ----------
    is_optional : bool
        Whether work goes on if nothing can be written to it.
    """

    def __init__(self, stream: io.TextIOWrapper, is_optional: bool) -> None:
        self._stream, self._is_optional = stream, is_optional

    def write(self, text: str) -> int:
        """Write text."""
        if not isinstance(text, str):
            raise TypeError(f"expected text, not {type(text).__name__}")
        with self._tolerate_errors():
            self._stream.write(make_printable(text))
        return len(text)

    def flush(self) -> None:
        """Write what is buffered."""
        with self._tolerate_errors():
            self._stream.flush()

    @contextmanager
    def _tolerate_errors(self) -> Iterator[None]:
        """After an error of an optional stream, let it lead nowhere."""
        try:
            yield
        except OSError:
            if not self._is_optional:
                raise
            with suppress(OSError):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, self._stream.fileno())  # what is buffered goes there, too
                os.close(nowhere)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def printable_streams() -> Iterator[None]:
    """Make the standard streams printable in the block."""
    streams = sys.stdout, sys.stderr
    try:
        # Messages may be lost, the answer may not.
        sys.stdout = _make_printable_stream(sys.stdout, is_optional=False)
        sys.stderr = _make_printable_stream(sys.stderr, is_optional=True)
        yield
    finally:
        sys.stdout, sys.stderr = streams


def _make_printable_stream(stream: Any, is_optional: bool) -> Any:
    """Return a stream that replaces control characters; None for one that was closed."""
    if not isinstance(stream, io.TextIOWrapper):
        return stream
    # click would write past us to a stream of ASCII, which it takes for misconfigured.
    is_ascii = codecs.lookup(stream.encoding).name == "ascii"
    # File names may have any bytes.
    stream.reconfigure(encoding="utf-8" if is_ascii else None, errors="backslashreplace")
    return PrintableStream(stream, is_optional)
