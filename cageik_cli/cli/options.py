"""Options that several commands share, and the types of their values."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from cageik_cli.cli.config import read_config
from cageik_cli.threads import processors

Command = TypeVar("Command", bound=Callable[..., Any])

PATH = click.Path(path_type=Path)
_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}


class Size(click.ParamType):  # type: ignore[type-arg]  # not subscriptable before click 8.4
    """Bytes, such as 512MiB, 2GiB or 1000000."""

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Parse the text."""
        match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?", str(value), re.IGNORECASE)
        if not match or float(match[1]) == 0:
            self.fail(f"{value!r} is not a size such as 512MiB or 1GiB", param, ctx)
        return int(float(match[1]) * _UNITS[match[2].upper()])


def common(command: Command) -> Command:
    """-v, -q and --config."""
    for option in (
        click.option(
            "--config",
            type=PATH,
            is_eager=True,
            expose_value=False,
            callback=read_config,
            help="A TOML file with options under [COMMAND]; the command line wins.",
        ),
        click.option("-q", "--quiet", is_flag=True, help="Say nothing but errors."),
        click.option(
            "-v",
            "--verbose",
            count=True,
            expose_value=False,
            callback=_remember_verbosity,
            help="Say more; -vv shows where an error arose.",
        ),
    ):
        command = option(command)
    return command


def jobs(command: Command) -> Command:
    """--jobs."""
    return click.option(
        "--jobs",
        type=click.IntRange(min=1),
        default=processors,
        show_default="processors",
        help="Threads.",
    )(command)


def verbosity() -> int:
    """How many -v were given."""
    return int(click.get_current_context().find_root().meta.get("verbosity", 0))


def write_or_print(text: str, target: Path, overwrite: bool) -> None:
    """Write to a file, or to stdout for the name `-`."""
    from cageik_cli.outputs import write_text

    if str(target) == "-":
        click.echo(text, nl=False)
    else:
        write_text(target, text, overwrite)


def _remember_verbosity(ctx: click.Context, param: click.Parameter, value: int) -> None:
    ctx.find_root().meta["verbosity"] = value
