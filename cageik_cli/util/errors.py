"""What a user can act on: what was found and where, what was expected, what to do."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager


class CageikError(Exception):
    """An error the user can act on; its text is one sentence, ready to be shown."""


class InputError(CageikError):
    """A file or folder does not hold what it should."""


class NumericalError(CageikError):
    """The numbers cannot be trusted, although the files are sound."""


@contextmanager
def located(place: object) -> Iterator[None]:
    """Put `place` (a file, a member of a file) in front of the message of errors raised inside."""
    try:
        yield
    except CageikError as error:
        raise type(error)(f"{place}: {error}") from error


def sentence_of(error: BaseException) -> str:
    """What went wrong, and what was noted on the error on its way: what is kept, how to go on."""
    return "; ".join([cause_of(error), *getattr(error, "__notes__", ())])


def cause_of(error: BaseException) -> str:
    """What went wrong, in a sentence."""
    if isinstance(error, CageikError):
        text = str(error)
    elif isinstance(error, KeyboardInterrupt):
        text = "interrupted"
    elif isinstance(error, OSError):
        text = f"{error.filename or 'the system'}: {error.strerror or error}"
    elif isinstance(error, MemoryError):
        text = "out of memory; use a coarser cage, or a smaller --memory"
    else:
        text = (
            f"a fault of cageik itself ({type(error).__name__}: {error}); "
            "please report it with the output of the same command with -vv"
        )
    return " ".join(text.split())


def first_few(things: Iterable[object], limit: int = 10) -> str:
    """List the first `limit` of them, with a mark when there are more."""
    listed = [str(thing) for thing in things]
    return ", ".join(listed[:limit]) + (", ..." if len(listed) > limit else "")


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
