"""Errors and warnings of USD: errors are converted, warnings kept instead of printed."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cageik_cli.util.errors import require_optional

_NOT_TEXT = "its text is not UTF-8"
USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")


def require_usd(purpose: str) -> None:
    """Raise MissingLibraryError without usd-core, which is needed for a purpose."""
    with require_optional("usd-core", "usd", purpose):
        import pxr  # noqa: F401


@contextmanager
def capture_diagnostics(make_error: Callable[[str], Exception]) -> Iterator[list[str]]:
    """Yield a list that gets the warnings of USD when the block ends.

    An error that USD raises in the block is converted by `make_error`.
    """
    from pxr import Tf

    warnings: list[str] = []
    with Tf.DiagnosticTrap() as trap:
        try:
            yield warnings
        except Tf.ErrorException as error:
            raise make_error(_format_diagnostic(error.args[0])) from error
        except UnicodeDecodeError as error:
            raise make_error(_NOT_TEXT) from error
        finally:
            warnings += map(_format_diagnostic, trap.GetWarnings())
            trap.Clear()


def _format_diagnostic(diagnostic: Any) -> str:
    """Return one line without folders, memory addresses and names of parser rules."""
    try:
        text = " ".join(diagnostic.commentary.split())
    except UnicodeDecodeError:
        return _NOT_TEXT
    text = re.sub(r" matching pxrInternal.*? at ", " at ", text)
    text = re.sub(r" \(\w+ stage on stage .*\)$", "", text)
    return re.sub(r"@([^@]*)@", lambda layer: Path(layer[1]).name, text)
