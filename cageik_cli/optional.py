"""Optional libraries: what to install when one is asked for that is not here."""

from collections.abc import Iterator
from contextlib import contextmanager

from cageik_cli.errors import InputError


@contextmanager
def needing(library: str, extra: str, act: str) -> Iterator[None]:
    """Make of an import that fails inside a sentence on what to install.

    Parameters
    ----------
    library : str
        As package indexes call it.
    extra : str
        Which of our extras brings it.
    act : str
        What it is needed for: "reading .usdc".
    """
    try:
        yield
    except ImportError as error:
        raise InputError(f"{act} needs {library}: pip install 'cageik[{extra}]'") from error
