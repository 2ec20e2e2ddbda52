"""Options from TOML files: that of --config, and those of a batch beside its clips.

A file of --config has one table per command; the command line wins.

For a batch, a file in the clip's folder, or in one above it, may have options for all clips there,
at its top or in a table `[extract]`, and tables `[clips."walks/*"]` for clips whose path from that
folder matches. The nearer file wins, in one file the later table, and the command line over all.
Paths are from the folder of the file; `{clip}` in them is the clip's own folder.

Clips come from other people, and such files with them. They can name inputs, but nothing that is
written; above the folders that are searched, files of other users are not read.
"""

import os
import re
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from difflib import get_close_matches
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.command import BLANK_VALUE, GroupedOption, spell_param
from cageik_cli.util.errors import FileAccessError, FormatError, SettingError
from cageik_cli.util.files import read_input
from cageik_cli.util.settings import Setting

CLIPS_TABLE = "clips"
"""The table of the tables for some clips of `cageik batch`."""

MAX_CONFIG_BYTES = 1 << 20
"""Bytes of a file of options; ours have a few hundred per clip at most."""

MAX_KEY_PARTS = 16
"""Parts of a key, such as `clips."walks/*".alpha`; tomllib takes the square of their time."""


def apply_config(ctx: click.Context, param: click.Parameter, path: Path | None) -> None:
    """Make the entries of the file's table for this command its defaults."""
    if path is None:
        return
    tables, name = read_tables(path), str(ctx.info_name)
    check_tables(path, tables, list_commands(ctx))
    chosen = parse_options(path, name, tables.get(name, {}), ctx.command)
    ctx.default_map = {**(ctx.default_map or {}), **chosen}


def read_tables(path: Path) -> dict[str, Any]:
    """Read a TOML file."""
    try:
        text = read_input(path, MAX_CONFIG_BYTES, may_be_empty=True).decode("utf-8-sig")
        part = r"""(?:[\w-]+|"[^"\n]*"|'[^'\n]*')"""
        if re.search(rf"(?<![\w-])(?:{part}[ \t]*\.[ \t]*){{{MAX_KEY_PARTS}}}", text):
            raise ValueError(f"a key has more than {MAX_KEY_PARTS} parts with dots between them")
        return tomllib.loads(text)
    except (FileAccessError, FormatError, ValueError, RecursionError) as error:
        raise click.BadParameter(f"{path}: cannot be read as TOML: {error}") from error


def parse_options(path: Path, title: str, table: Any, command: click.Command) -> dict[str, Any]:
    """Return the options that the table `title` of a file sets, by the names of parameters.

    An empty title stands for what is above the first table.
    """
    if not isinstance(table, dict):
        raise click.BadParameter(f"{path}: `{title}` is not a table of options")
    options = {
        spell_param(option).removeprefix("--").replace("-", "_"): option
        for option in command.params
        if isinstance(option, click.Option) and not option.is_eager
    }
    chosen = {}
    for key, value in table.items():
        option = options.get(key.replace("-", "_"))
        if option is None:
            raise click.BadParameter(
                f"{path}: {name_table(title)} has no option {key}; {_suggest_option(key, options)}"
            )
        values = value if option.multiple and isinstance(value, list) else [value]
        parts = value if isinstance(value, list) else [value]
        if any(isinstance(one, str) and not one.strip() for one in parts):
            raise click.BadParameter(f"{path}: {key}: {BLANK_VALUE}")
        if not all(_is_value_for(option, one) for one in values):
            raise click.BadParameter(f"{path}: {key} = {value!r} is not a value of --{key}")
        chosen[str(option.name)] = values if option.multiple else value
    return chosen


def name_table(title: str) -> str:
    """Name a table of a file in a message; an empty title stands for what is above the first."""
    return f"[{title}]" if title else "the part above the tables"


def _suggest_option(key: str, options: Iterable[str]) -> str:
    """Name the option that was probably meant, or all options."""
    known = sorted(name.replace("_", "-") for name in options)
    near = get_close_matches(key.replace("_", "-"), known, n=1)
    return f"did you mean {near[0]}?" if near else f"expected some of {', '.join(known)}"


def list_commands(ctx: click.Context) -> tuple[str, ...]:
    """Return the names of all commands of the group."""
    group = ctx.parent.command if ctx.parent else None
    return tuple(group.commands) if isinstance(group, click.Group) else (str(ctx.info_name),)


def check_tables(path: Path, tables: dict[str, Any], commands: Sequence[str]) -> None:
    """Refuse a file with anything but tables of commands and of clips."""
    for name, table in tables.items():
        if name not in [*commands, CLIPS_TABLE]:
            raise click.BadParameter(
                f"{path}: {name} is not a command; expected tables of options, "
                f'{", ".join(f"[{command}]" for command in commands)}, or [{CLIPS_TABLE}."PATTERN"]'
            )
        if not isinstance(table, dict):
            raise click.BadParameter(f"{path}: `{name}` is not a table of options")


def _is_value_for(option: click.Option, value: object) -> bool:
    """Tell whether a TOML value may stand for what is typed; click parses it afterwards."""
    if isinstance(value, str):
        return "\0" not in value  # cannot be typed
    if isinstance(getattr(option.type, "kind", option.type), click.Path):
        return False
    if isinstance(value, bool) or isinstance(option.type, click.types.BoolParamType):
        return isinstance(value, bool) and isinstance(option.type, click.types.BoolParamType)
    if isinstance(option.type, click.types.IntParamType):
        return isinstance(value, int)
    return isinstance(value, int | float)


CONFIG_NAME = "cageik.toml"
SYSTEM_USER = 0
"""Owner of the files of the system: root."""


class ClipTables:
    """The files of options, each read once.

    Parameters
    ----------
    command : click.Command
        The command whose options a clip may set.
    commands : sequence of str
        Commands that may have tables in a file; only that of `command` is read.
    folders : sequence of Path
        The folders that are searched. Above them, only files of the user or of the system count.
    """

    def __init__(
        self,
        command: click.Command,
        commands: Sequence[str],
        folders: Sequence[Path] = (),
    ) -> None:
        self._command = command
        self._commands = commands
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
                if title in ("", "extract") or fnmatch(name, pattern):
                    options |= self._resolve_options(file, title, table, folder)
        return options

    def find_auxiliary_files(self, folder: Path) -> set[Path]:
        """Return every file that a table names for clips of this folder.

        A file of options that cannot be read is skipped here, and so is a name that means nothing;
        the clips report the error.
        """
        from cageik_cli.formats.find_files import Source

        files: set[Path] = set()
        for file in self._config_files(folder):
            try:
                tables = [
                    self._resolve_options(file, *table, folder)
                    for table in self._read_clip_tables(file)
                ]
            except click.UsageError:
                continue
            named = [
                value
                for table in tables
                for name, value in table.items()
                if is_auxiliary_path(self._command, name, value)
            ]
            for value in named:
                with suppress(SettingError):
                    files.add(Source.parse(value).file.resolve())
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
        if "extract" in tables:
            yield "extract", tables["extract"]
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
            setting = find_setting(self._command, name)
            if not setting.is_per_clip:
                raise click.BadParameter(
                    f"{file}: {name_table(title)} sets {self._name_option(name)}, which no clip of "
                    "a batch has of its own; remove it, or use an option of cageik batch"
                )
            if setting.role == "written":
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
        option = next(option for option in self._command.params if option.name == name)
        return spell_param(option).removeprefix("--")


def _is_trusted(file: Path) -> bool:
    """Tell whether a file, and a link to it, belong to the user or to the system."""
    owners = {file.stat().st_uid, file.lstat().st_uid}
    return os.name != "posix" or owners <= {SYSTEM_USER, os.getuid()}


def _resolve_path(file: Path, value: str, folder: Path) -> str:
    """Return a path of a file of options, for clips in `folder`."""
    return str(file.parent / value.replace("{clip}", str(folder.absolute())))


def is_auxiliary_path(command: click.Command, name: str, value: object) -> bool:
    """Tell whether a parameter names a file that is no frame; a rest pose may be a frame."""
    return is_path(command, name, value) and not find_setting(command, name).may_be_frame


def find_setting(command: click.Command, name: str) -> Setting:
    """Return what is said of the setting of an option."""
    option = next(param for param in command.params if param.name == name)
    return option.setting if isinstance(option, GroupedOption) else Setting("")


def is_path(command: click.Command, name: str, value: object) -> bool:
    """Tell whether the value of a parameter is a path, and no word that its type knows."""
    types = [param.type for param in command.params if param.name == name]
    return any(
        isinstance(getattr(kind, "kind", kind), click.Path) and value != getattr(kind, "word", None)
        for kind in types
    )
