"""Errors that a user can act on: where, what was found, what was expected, what to do."""

import errno
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import ClassVar

from cageik_cli.util.messages import Said, Text, collapse_spaces, join_texts, say, spell


class CageikError(Exception):
    """An error that the user can act on; its text is one sentence, ready to show.

    Attributes
    ----------
    kind : str
        What is at fault, in one word. Programs tell errors apart by it, not by their text.
    locations : tuple of str or Text
        Where it happened, from the outermost place to the innermost. The text begins with them.

    Examples
    --------
    >>> from cageik_cli import CageikError, load_mesh
    >>> try:
    ...     load_mesh("nowhere.obj")
    ... except CageikError as error:
    ...     print(error)
    nowhere.obj: no such file; check the path
    """

    kind: ClassVar[str] = "error"
    locations: tuple[Said, ...] = ()

    def add_location(self, location: object) -> None:
        """Name a place, such as a file, around those that are named already."""
        place = location if isinstance(location, Text) else str(location)
        self.locations = (place, *self.locations)

    @property
    def text(self) -> Said:
        """What is said, with the settings that it names apart; behind the locations."""
        message = self.args[0] if len(self.args) == 1 else super().__str__()
        return join_texts(": ", [*self.locations, message]) if self.locations else message

    def __str__(self) -> str:
        return spell(self.text)


class InputError(CageikError):
    """A file, a folder or a setting is not what it should be."""

    kind = "input"


class FileAccessError(InputError):
    """A file or folder is missing, of the wrong sort, or cannot be read."""

    kind = "file"


class MissingFrameError(FileAccessError):
    """A frame has no file, in a clip whose gaps are kept."""


class FormatError(InputError):
    """The content of a file is not what its format says: damaged, cut short, of another kind."""

    kind = "format"


class ConnectivityError(InputError):
    """Meshes that must share one connectivity do not."""

    kind = "connectivity"


class CageError(InputError):
    """A cage is not fit to hold the model.

    Attributes
    ----------
    is_repairable : bool
        Whether `cageik cage --repair` may make it fit.
    """

    kind = "cage"
    is_repairable: bool = False


class HandlesError(InputError):
    """A handles file, or what it asks of the model, is at fault."""

    kind = "handles"


class SettingError(InputError):
    """A setting has a value that it cannot have, or contradicts another."""

    kind = "setting"


class WrongUsageError(SettingError):
    """A setting has a value that is wrong with any input."""


class OutputError(InputError):
    """An output exists already, overlaps with an input, or cannot be written."""

    kind = "output"


class CheckpointError(InputError):
    """A checkpoint or result belongs to another run, or another run is writing it."""

    kind = "checkpoint"


class MissingLibraryError(InputError):
    """An optional library is not installed."""

    kind = "library"


class ClusterError(InputError):
    """A cluster does not answer, or its workers cannot do the work."""

    kind = "cluster"


class NumericalError(CageikError):
    """The numbers cannot be trusted, although the files are sound."""

    kind = "numerics"


class BusyError(CageikError):
    """What is asked for waits until something else is done."""

    kind = "busy"


class SlowError(CageikError):
    """Something took so long that it was ended."""

    kind = "slow"


@contextmanager
def error_context(location: object) -> Iterator[None]:
    """Add a location, such as a file, to errors raised inside; they stay the same objects."""
    try:
        yield
    except CageikError as error:
        error.add_location(location)
        raise


def add_remark(error: BaseException, remark: Said) -> None:
    """Add to any error what is kept, or how to continue; `format_error` shows it."""
    error.add_note(spell(remark))
    vars(error).setdefault("remarks", {})[spell(remark)] = remark


def format_error(error: BaseException) -> Said:
    """Return the text of an error and of its notes: what is kept, how to continue."""
    remarks, notes = getattr(error, "remarks", {}), getattr(error, "__notes__", ())
    return join_texts("; ", [describe_error(error), *(remarks.get(note, note) for note in notes)])


def describe_error(error: BaseException) -> Said:
    """Return the text of any error, on one line."""
    text: Said
    if isinstance(error, CageikError):
        text = error.text
    elif isinstance(error, KeyboardInterrupt):
        text = "interrupted"
    elif isinstance(error, OSError):
        text = f"{error.filename or 'the system'}: {error.strerror or error}"
    elif isinstance(error, ModuleNotFoundError) and _is_foreign(error.name):
        library = str(error.name).partition(".")[0]
        package = {"igl": "libigl", "PIL": "pillow"}.get(library, library)
        text = (
            f"the library {library} is missing, which every installation of cageik has; "
            f"pip install {package}"
        )
    elif isinstance(error, ImportError) and not isinstance(error, ModuleNotFoundError):
        text = (
            f"a library cannot be loaded ({error}); check the memory that is free, the limit of "
            "open files (ulimit -n), and the installation"
        )
    elif isinstance(error, MemoryError):
        text = say("out of memory; use a coarser cage, or a smaller `memory=`")
    else:
        text = (
            f"internal error ({type(error).__name__}: {error}); "
            "please report it with the output of the same command with -vv"
        )
    return collapse_spaces(text)


def _is_foreign(module: str | None) -> bool:
    """Return whether a module that is not found is of another package, and has a name."""
    return bool(module) and str(module).partition(".")[0] != __name__.partition(".")[0]


def make_write_error(path: object, error: OSError) -> OutputError:
    """Make the error that an output cannot be written; one that has no room says what to do.

    Without room, an unfinished file is named as the file that is wanted.
    """
    reason, remedy = error.strerror or str(error), ""
    if _has_code(error, errno.ENOSPC, errno.EDQUOT):
        remedy = "; free some space on its disk, or choose another place"
    elif _has_code(error, errno.EFBIG):
        remedy = (
            "; raise the limit of file sizes (ulimit -f unlimited), or choose a place that takes "
            "larger files"
        )
    name = str(path).removesuffix(".partial") if remedy else path
    return OutputError(f"{name}: cannot be written ({reason}){remedy}")


def _has_code(error: OSError, *codes: int) -> bool:
    """Return whether an error has one of some codes; libraries have only their words."""
    return error.errno in codes or any(os.strerror(code) in str(error) for code in codes)


MAX_NAMED = 3
"""Things that a sentence names; the others are counted."""

MAX_LISTED = 10
"""Choices, and numbers of vertices and faces, that a sentence lists: more of them are of help."""


def join_truncated(items: Iterable[object], limit: int = MAX_NAMED) -> str:
    """Join the first `limit` items, and count the others: "a, b, c and 57 more"."""
    listed = [str(item) for item in items]
    more = len(listed) - limit
    return ", ".join(listed[:limit]) + (f" and {more} more" if more > 0 else "")


@contextmanager
def require_optional(library: str, purpose: str) -> Iterator[None]:
    """Turn the import of a library that is missing into an error that says what to install.

    The library has its name in package indexes, and `purpose` is what it is needed for: "reading
    .usdc".
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingLibraryError(
            f"{purpose} needs {library}, which is not installed: pip install {library}"
        ) from error
