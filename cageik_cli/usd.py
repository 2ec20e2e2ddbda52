"""USD's own voice: its errors become ours, its warnings are kept instead of printed."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from cageik_cli.optional import needing

SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")


def need_usd(act: str) -> None:
    """Refuse to go on without usd-core; `act` is what it is needed for."""
    with needing("usd-core", "usd", act):
        import pxr  # noqa: F401


@contextmanager
def quiet(failed: Callable[[str], Exception]) -> Iterator[Any]:
    """A trap of what USD would print to stderr; of an error it raises, `failed` makes another."""
    from pxr import Tf

    with Tf.DiagnosticTrap() as trap:
        try:
            yield trap
        except Tf.ErrorException as error:
            raise failed(_sentence(error.args[0].commentary)) from error
        except UnicodeDecodeError as error:
            raise failed("its text is not UTF-8") from error


def warnings_of(trap: Any) -> list[str]:
    """What USD has warned of since the trap was set, a line each."""
    return [_sentence(warning.commentary) for warning in trap.GetWarnings()]


def _sentence(text: str) -> str:
    """On one line, and without the names of the parser's rules."""
    return re.sub(r" matching pxrInternal.*? at ", " at ", " ".join(text.split()))
