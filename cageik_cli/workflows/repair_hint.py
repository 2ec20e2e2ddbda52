"""The command that repairs a cage, ready to be typed, for the messages that refuse it."""

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cageik_cli.formats.base.files import file_suffix
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.open import mesh_suffixes
from cageik_cli.util.errors import CageError

UNNAMED_REST = "MODEL.obj"
"""Stands for a rest pose that is in no mesh file."""


def format_repair_command(cage: Path, rest: Path | None) -> str:
    """Return the command that repairs a cage for a rest pose."""
    words = ["cageik", "cage", "--repair", str(cage), "--rest", str(rest or UNNAMED_REST)]
    words += ["-o", f"{cage.name.split('.')[0]}_repaired.obj"]
    command = shlex.join(words)
    if rest is None:
        command += f" ({UNNAMED_REST}: the rest pose, as a mesh file)"
    return command


@contextmanager
def suggest_repair(cage: Path | None, rest: Path | None) -> Iterator[None]:
    """Add the command to errors raised inside about a cage that a repair may mend.

    A cage that is in no file is left alone.
    """
    try:
        yield
    except CageError as error:
        if cage is None or not error.is_repairable:
            raise
        raise CageError(
            f"{error}; to repair the cage: {format_repair_command(cage, rest)}"
        ) from error


def find_rest_file(sequence: MeshSequence, index: int) -> Path | None:
    """Return the mesh file of a frame of a clip; None if the frame is in a file of many."""
    path = Path(sequence.location(index))
    return path if file_suffix(path) in mesh_suffixes() and path.is_file() else None
