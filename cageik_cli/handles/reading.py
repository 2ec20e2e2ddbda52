"""A handles file, read."""

from pathlib import Path

from cageik_cli.handles.records import Handles


def read_handles(path: Path) -> Handles:
    """Read a handles file.

    Raises
    ------
    InputError
        Naming the file, the handle and the field that is not what it should be.
    """
    raise NotImplementedError
