"""What each clip of a batch is given: options from `cageik.toml`, layer over layer.

A file in the clip's folder, or in one above it, may have a table `[extract]` for all clips there,
and tables `[clips."walks/*"]` for those whose path from that file's folder matches. The nearer file
wins, in a file the later table, and the command line over all. Paths are from the file's folder.
"""

from collections.abc import Iterator, Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.config import CLIPS, options_of, read_tables, refuse_other_tables

NAME = "cageik.toml"
COMMAND = "extract"


class ClipTables:
    """The files of options, each read once.

    Parameters
    ----------
    command : click.Command
        With the options that a clip may be given.
    commands : sequence of str
        Whose tables a file may hold; only that of `command` is read.
    of_batch : sequence of str
        Options of `command` that are for the whole batch, by parameters' names.
    """

    def __init__(
        self, command: click.Command, commands: Sequence[str], of_batch: Sequence[str]
    ) -> None:
        self._command = command
        self._commands = commands
        self._of_batch = of_batch
        self._read: dict[Path, dict[str, Any]] = {}

    def given(self, home: Path, path: Path) -> dict[str, Any]:
        """What the clip at `path`, in the folder `home`, is given, by parameters' names.

        Raises
        ------
        click.BadParameter
            Naming the file that is at fault.
        """
        chosen: dict[str, Any] = {}
        for file in reversed(list(self._files(home))):
            name = path.relative_to(file.parent).as_posix()
            for title, table in self._tables(file):
                pattern = title.removeprefix(f"{CLIPS}.")
                if title == COMMAND or fnmatch(name, pattern):
                    chosen |= self._placed(file, title, table)
        return chosen

    def paths(self, folder: Path) -> set[Path]:
        """Every file that tables of this folder, or of those above it, name.

        A file that cannot be read names none; its clips are told.
        """
        named: set[Path] = set()
        for file in self._files(folder):
            try:
                tables = [self._placed(file, *table) for table in self._tables(file)]
            except click.UsageError:
                continue
            named.update(
                Path(value).resolve()
                for table in tables
                for name, value in table.items()
                if is_no_frame(self._command, name)
            )
        return named

    def _files(self, folder: Path) -> Iterator[Path]:
        """Those that count in a folder, its own first."""
        place = folder.absolute()
        return (above / NAME for above in (place, *place.parents) if (above / NAME).is_file())

    def _tables(self, file: Path) -> Iterator[tuple[str, Any]]:
        if file not in self._read:
            tables = read_tables(file)
            refuse_other_tables(file, tables, self._commands)
            self._read[file] = tables
        tables = self._read[file]
        if COMMAND in tables:
            yield COMMAND, tables[COMMAND]
        yield from (
            (f"{CLIPS}.{pattern}", table) for pattern, table in tables.get(CLIPS, {}).items()
        )

    def _placed(self, file: Path, title: str, table: Any) -> dict[str, Any]:
        """A table's options, paths made absolute."""
        chosen = options_of(file, title, table, self._command)
        for name in chosen:
            if name in self._of_batch:
                raise click.BadParameter(
                    f"{file}: [{title}] sets {name}, which is not of one clip; give it to "
                    "cageik batch, if it has it"
                )
        return {
            name: str(file.parent / value) if is_path(self._command, name) else value
            for name, value in chosen.items()
        }


def is_no_frame(command: click.Command, name: str) -> bool:
    """Whether what a parameter names is a file beside a clip: a rest pose may be a frame of it."""
    return name != "rest" and is_path(command, name)


def is_path(command: click.Command, name: str) -> bool:
    """Whether the values of a parameter are paths."""
    return any(
        param.name == name and isinstance(param.type, click.Path) for param in command.params
    )
