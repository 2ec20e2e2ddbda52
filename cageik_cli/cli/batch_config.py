"""The options of each clip of a batch, from `cageik.toml` files and the command line.

A file in the clip's folder, or in one above it, may have options for all clips there, at its top
or in a table `[extract]`, and tables `[clips."walks/*"]` for clips whose path from that folder
matches. The nearer file wins, in one file the later table, and the command line over all. Paths are
from the folder of the file; `{clip}` in them is the clip's own folder.

Clips come from other people, and such files with them. They can name inputs, but nothing that is
written; above the folders that are searched, files of other users are not read.
"""

import os
from collections.abc import Iterator, Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.config import CLIPS_TABLE, check_tables, name_table, parse_options, read_tables

CONFIG_NAME = "cageik.toml"
EXTRACT_COMMAND = "extract"

WRITTEN_OPTIONS = ("cache",)
"""Options of a clip that name what is written; a file among the clips may not have them."""

SYSTEM_USER = 0
"""Owner of the files of the system: root."""

CLIP_FOLDER = "{clip}"
"""Stands for the clip's own folder in paths."""


class ClipTables:
    """The files of options, each read once.

    Parameters
    ----------
    command : click.Command
        The command whose options a clip may set.
    commands : sequence of str
        Commands that may have tables in a file; only that of `command` is read.
    batch_options : sequence of str
        Options of `command` that apply to the whole batch, by the names of parameters.
    folders : sequence of Path
        The folders that are searched. Above them, only files of the user or of the system count.
    """

    def __init__(
        self,
        command: click.Command,
        commands: Sequence[str],
        batch_options: Sequence[str],
        folders: Sequence[Path] = (),
    ) -> None:
        self._command = command
        self._commands = commands
        self._batch_options = batch_options
        self._folders = [folder.absolute() for folder in folders]
        self._tables_by_file: dict[Path, dict[str, Any]] = {}

    def collect_options(self, folder: Path, path: Path) -> dict[str, Any]:
        """Collect the options of the clip at `path`, in `folder`, by the names of parameters.

        Raises
        ------
        click.BadParameter
            Naming the wrong file.
        """
        options: dict[str, Any] = {}
        for file in reversed(list(self._config_files(folder))):
            name = path.relative_to(file.parent).as_posix()
            for title, table in self._read_clip_tables(file):
                pattern = title.removeprefix(f"{CLIPS_TABLE}.")
                if title in ("", EXTRACT_COMMAND) or fnmatch(name, pattern):
                    options |= self._resolve_options(file, title, table, folder)
        return options

    def find_auxiliary_files(self, folder: Path) -> set[Path]:
        """Return every file that a table names for clips of this folder.

        A file of options that cannot be read is skipped here; its clips report the error.
        """
        files: set[Path] = set()
        for file in self._config_files(folder):
            try:
                tables = [
                    self._resolve_options(file, *table, folder)
                    for table in self._read_clip_tables(file)
                ]
            except click.UsageError:
                continue
            files.update(
                Path(value).resolve()
                for table in tables
                for name, value in table.items()
                if is_auxiliary_path(self._command, name, value)
            )
        return files

    def _config_files(self, folder: Path) -> Iterator[Path]:
        """List the files that apply to a folder, its own first."""
        place = folder.absolute()
        return (
            above / CONFIG_NAME
            for above in (place, *place.parents)
            if (above / CONFIG_NAME).is_file()
            and (self._is_searched(above) or _is_trusted(above / CONFIG_NAME))
        )

    def _is_searched(self, folder: Path) -> bool:
        """Tell whether a folder is one that is searched, or in one."""
        return any(searched in (folder, *folder.parents) for searched in self._folders)

    def _read_clip_tables(self, file: Path) -> Iterator[tuple[str, Any]]:
        if file not in self._tables_by_file:
            self._tables_by_file[file] = self._split_tables(file, read_tables(file))
        tables = self._tables_by_file[file]
        yield "", tables[""]
        if EXTRACT_COMMAND in tables:
            yield EXTRACT_COMMAND, tables[EXTRACT_COMMAND]
        yield from (
            (f"{CLIPS_TABLE}.{pattern}", table)
            for pattern, table in tables.get(CLIPS_TABLE, {}).items()
        )

    def _split_tables(self, file: Path, entries: dict[str, Any]) -> dict[str, Any]:
        """Return the checked tables of a file, and under an empty name what is above them.

        An option may have the name of a command.
        """
        names = {str(param.name) for param in self._command.params}
        reserved = {*self._commands, CLIPS_TABLE} - names
        top = {
            name: value
            for name, value in entries.items()
            if not isinstance(value, dict) and name not in reserved
        }
        tables = {name: table for name, table in entries.items() if name not in top}
        check_tables(file, tables, self._commands)
        return {**tables, "": top}

    def _resolve_options(self, file: Path, title: str, table: Any, folder: Path) -> dict[str, Any]:
        """Return the options of a table for clips in `folder`, with absolute paths."""
        options = parse_options(file, title, table, self._command)
        for name in options:
            if name in self._batch_options:
                raise click.BadParameter(
                    f"{file}: {name_table(title)} sets {self._name_option(name)}, which no clip of "
                    "a batch has of its own; remove it, or use an option of cageik batch"
                )
            if name in WRITTEN_OPTIONS:
                raise click.BadParameter(
                    f"{file}: {name_table(title)} sets {self._name_option(name)}, which a file "
                    f"among clips may not; use --{self._name_option(name)}, or CAGEIK_CACHE"
                )
        return {
            name: _resolve_path(file, value, folder)
            if is_path(self._command, name, value)
            else value
            for name, value in options.items()
        }

    def _name_option(self, name: str) -> str:
        """Name a parameter as a file of options does."""
        options = [option for option in self._command.params if option.name == name]
        return max(options[0].opts, key=len).removeprefix("--")


def _is_trusted(file: Path) -> bool:
    """Tell whether a file, and a link to it, belong to the user or to the system."""
    owners = {file.stat().st_uid, file.lstat().st_uid}
    return os.name != "posix" or owners <= {SYSTEM_USER, os.getuid()}


def _resolve_path(file: Path, value: str, folder: Path) -> str:
    """Return a path of a file of options, for clips in `folder`."""
    return str(file.parent / value.replace(CLIP_FOLDER, str(folder.absolute())))


def is_auxiliary_path(command: click.Command, name: str, value: object) -> bool:
    """Tell whether a parameter names a file that is no frame; a rest pose may be a frame."""
    return name != "rest" and is_path(command, name, value)


def is_path(command: click.Command, name: str, value: object) -> bool:
    """Tell whether the value of a parameter is a path, and no word that its type knows."""
    types = [param.type for param in command.params if param.name == name]
    return any(
        isinstance(kind, click.Path) and value not in getattr(kind, "words", ()) for kind in types
    )
