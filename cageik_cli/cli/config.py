"""Options from a TOML file, one table per command; the command line wins."""

import re
import tomllib
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import click

from cageik_cli.util.errors import FileAccessError
from cageik_cli.util.files import read_input

CLIPS_TABLE = "clips"
"""The table of the tables for some clips of `cageik batch`."""

MAX_CONFIG_BYTES = 1 << 20
"""Bytes of a file of options; ours have a few hundred per clip at most."""

MAX_KEY_PARTS = 16
"""Parts of a key, such as `clips."walks/*".alpha`; tomllib takes the square of their time."""

_KEY_PART = r"""(?:[\w-]+|"[^"\n]*"|'[^'\n]*')"""
_DEEP_KEY = re.compile(rf"(?<![\w-])(?:{_KEY_PART}[ \t]*\.[ \t]*){{{MAX_KEY_PARTS}}}")


def apply_config(ctx: click.Context, param: click.Parameter, path: Path | None) -> None:
    """Make the entries of the file's table for this command its defaults.

    Raises
    ------
    click.BadParameter
        Naming the file, when it is not TOML, or an entry is not an option or not a value of it.
    """
    if path is None:
        return
    tables, name = read_tables(path), str(ctx.info_name)
    check_tables(path, tables, list_commands(ctx))
    chosen = parse_options(path, name, tables.get(name, {}), ctx.command)
    ctx.default_map = {**(ctx.default_map or {}), **chosen}


def read_tables(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    click.BadParameter
        Naming the file, when it is not TOML.
    """
    try:
        text = read_input(path, MAX_CONFIG_BYTES).decode("utf-8-sig")
        if _DEEP_KEY.search(text):
            raise ValueError(f"a key has more than {MAX_KEY_PARTS} parts with dots between them")
        return tomllib.loads(text)
    except (FileAccessError, ValueError, RecursionError) as error:
        raise click.BadParameter(f"{path}: cannot be read as TOML: {error}") from error


def parse_options(path: Path, title: str, table: Any, command: click.Command) -> dict[str, Any]:
    """Return the options that the table `title` of a file sets, by the names of parameters.

    An empty title stands for what is above the first table.

    Raises
    ------
    click.BadParameter
        Naming the file, when it is not a table, or an entry is not an option or not a value of it.
    """
    if not isinstance(table, dict):
        raise click.BadParameter(f"{path}: `{title}` is not a table of options")
    options = {
        _option_key(option): option
        for option in command.params
        if isinstance(option, click.Option) and option.name != "config"
    }
    chosen = {}
    for key, value in table.items():
        option = options.get(key.replace("-", "_"))
        if option is None:
            raise click.BadParameter(
                f"{path}: {name_table(title)} has no option {key}; {_suggest_option(key, options)}"
            )
        values = value if option.multiple and isinstance(value, list) else [value]
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


def _option_key(param: click.Parameter) -> str:
    """Return the name of an option as it is typed, without dashes."""
    longest = max(param.opts, key=len)
    return longest.removeprefix("--").replace("-", "_")


def list_commands(ctx: click.Context) -> tuple[str, ...]:
    """Return the names of all commands of the group."""
    group = ctx.parent.command if ctx.parent else None
    return tuple(group.commands) if isinstance(group, click.Group) else (str(ctx.info_name),)


def check_tables(path: Path, tables: dict[str, Any], commands: Sequence[str]) -> None:
    """Refuse a file with anything but tables of commands and of clips.

    Raises
    ------
    click.BadParameter
        Naming the file and the entry.
    """
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
    if isinstance(option.type, click.Path):
        return False
    if isinstance(value, bool) or isinstance(option.type, click.types.BoolParamType):
        return isinstance(value, bool) and isinstance(option.type, click.types.BoolParamType)
    if isinstance(option.type, click.types.IntParamType):
        return isinstance(value, int)
    return isinstance(value, int | float)
