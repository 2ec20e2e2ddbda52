"""USD's own voice: its errors become ours, its warnings are kept instead of printed."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cageik_cli.util.errors import require_optional

_NOT_TEXT = "its text is not UTF-8"
USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")


def require_usd(purpose: str) -> None:
    """Refuse to go on without usd-core; `purpose` is what it is needed for."""
    with require_optional("usd-core", "usd", purpose):
        import pxr  # noqa: F401


@contextmanager
def capture_diagnostics(make_error: Callable[[str], Exception]) -> Iterator[list[str]]:
    """A list that holds, when the block ends, what USD would have printed, a sentence each.

    Of an error that USD raises in the block, `make_error` makes another.
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
    """On one line, without folders, addresses in memory and the names of the parser's rules."""
    try:
        text = " ".join(diagnostic.commentary.split())
    except UnicodeDecodeError:
        return _NOT_TEXT
    text = re.sub(r" matching pxrInternal.*? at ", " at ", text)
    text = re.sub(r" \(\w+ stage on stage .*\)$", "", text)
    return re.sub(r"@([^@]*)@", lambda layer: Path(layer[1]).name, text)
