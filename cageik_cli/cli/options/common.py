"""Options that several commands share, and the types of their values."""

import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import click
from click.core import ParameterSource

from cageik_cli.cli.config import apply_config
from cageik_cli.cli.options.group import Decorator, OptionGroup
from cageik_cli.coordinates.settings import (
    ACCURACIES,
    COORDINATES,
    OUTSIDE_POLICIES,
    BindSettings,
)
from cageik_cli.util.errors import CageikError

Command = TypeVar("Command", bound=Callable[..., Any])
PATH_TYPE = click.Path(path_type=Path)
_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}


class SizeType(click.ParamType):  # type: ignore[type-arg]  # not subscriptable before click 8.4
    """Bytes, such as 512MiB, 2GiB or 1000000."""

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Parse the text."""
        match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?", str(value), re.IGNORECASE)
        if not match or float(match[1]) == 0:
            self.fail(f"{value!r} is not a size such as 512MiB or 1GiB", param, ctx)
        return int(float(match[1]) * _UNITS[match[2].upper()])


def count_processors() -> int:
    """Return how many processors this process may use; the module that knows is slow to import."""
    from cageik_cli.util.threads import count_processors

    return count_processors()


class FrameFormatType(click.ParamType):  # type: ignore[type-arg]  # as above
    """A format of folders of frames: the formats are looked up when one is given."""

    name = "format"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Check the name."""
        from cageik_cli.formats.write import frame_formats

        known = frame_formats()
        if value not in known:
            self.fail(f"{value!r} is not one of {', '.join(map(repr, known))}.", param, ctx)
        return str(value)


def common_options(command: Command) -> Command:
    """Add -v, -q and --config."""
    for option in (
        click.option(
            "--config",
            type=PATH_TYPE,
            is_eager=True,
            expose_value=False,
            callback=apply_config,
            help="TOML file with options under [COMMAND]; the command line wins.",
        ),
        click.option("-q", "--quiet", is_flag=True, help="Print only errors and exceeded limits."),
        click.option(
            "-v",
            "--verbose",
            count=True,
            expose_value=False,
            callback=_remember_verbosity,
            help="Print more; -vv prints the traceback of an error.",
        ),
    ):
        command = option(command)
    return command


jobs_option = click.option(
    "--jobs",
    type=click.IntRange(min=1),
    default=count_processors,
    show_default="processors",
    help="Number of threads.",
)

memory_option = click.option(
    "--memory",
    type=SizeType(),
    default="1GiB",
    show_default=True,
    help="Memory limit for weights and frame buffers; one block of frames is always held.",
)

timings_option = click.option(
    "--timings", type=PATH_TYPE, help="Write the seconds of each stage to this JSON file."
)

recentre_option = click.option(
    "--recentre",
    is_flag=True,
    help="Move the animation to the origin, and write the offset beside it (OUT.offset.json).",
)

overwrite_option = click.option("--overwrite", is_flag=True, help="Replace existing outputs.")

format_option = click.option(
    "--format",
    "file_format",
    type=FrameFormatType(),
    metavar="[obj|ply]",
    help="File format when OUT is a folder.  [default: obj]",
)


def make_binding_options(defaults: BindSettings | None) -> tuple[Decorator, ...]:
    """Make --coordinates, --accuracy and --outside; without defaults, those of a result hold."""
    tolerances = ", ".join(f"{known.tolerance} {name}" for name, known in ACCURACIES.items())

    def default(name: str) -> dict[str, Any]:
        if defaults is None:
            return {"show_default": "that of the result"}
        return {"default": getattr(defaults, name), "show_default": True}

    return (
        click.option(
            "--coordinates",
            type=click.Choice(COORDINATES),
            help="Type of coordinates.",
            **default("coordinates"),
        ),
        click.option(
            "--accuracy",
            type=click.Choice(list(ACCURACIES)),
            help="Tolerance of the weights, the mean L1 error of a row: " + tolerances + ".",
            **default("accuracy"),
        ),
        click.option(
            "--outside",
            type=click.Choice(OUTSIDE_POLICIES),
            help="Vertices outside the cage: refuse them, or project them to the nearest point "
            "of the cage.",
            **default("outside"),
        ),
    )


BIND_OPTIONS = OptionGroup("bind", BindSettings, *make_binding_options(BindSettings()))


def is_on_command_line(name: str) -> bool:
    """Tell whether an option was given on the command line."""
    source = click.get_current_context().get_parameter_source(name)
    return source is ParameterSource.COMMANDLINE


def is_given(name: str) -> bool:
    """Tell whether an option was given on the command line or in a file of options."""
    source = click.get_current_context().get_parameter_source(name)
    return source in (ParameterSource.COMMANDLINE, ParameterSource.DEFAULT_MAP)


def choose_cache_folder(cache: Path | None, no_cache: bool) -> Path | None:
    """Return the folder of the cache; None for none.

    The command line comes before the file of options, then the environment, then the folder of
    the user.

    Raises
    ------
    click.UsageError
        When the command line both names and refuses one.
    """
    if is_on_command_line("cache") and is_on_command_line("no_cache"):
        raise click.UsageError("--cache and --no-cache exclude each other; leave one out")
    if no_cache and not is_on_command_line("cache"):
        return None
    named = cache or os.environ.get("CAGEIK_CACHE")
    if named:
        return Path(named)

    from platformdirs import user_cache_path

    return user_cache_path("cageik", appauthor=False)


CACHE_OPTIONS = OptionGroup(
    "cache",
    choose_cache_folder,
    click.option(
        "--cache",
        type=PATH_TYPE,
        help="Folder of the cache of weights and built cages.  [default: CAGEIK_CACHE, or the "
        "cache folder of the user]",
    ),
    click.option("--no-cache", is_flag=True, help="Do not use the cache."),
)


@contextmanager
def usage_errors() -> Iterator[None]:
    """Make wrong usage (exit code 2) of errors of settings that are raised inside."""
    try:
        yield
    except CageikError as error:
        raise click.UsageError(str(error)) from error


def get_verbosity() -> int:
    """Return how many -v were given."""
    return int(click.get_current_context().find_root().meta.get("verbosity", 0))


def write_or_print(view: str | bytes, target: Path, overwrite: bool) -> None:
    """Write to a file, or the same bytes to stdout for the name `-`.

    On a terminal, text is printed as all text is, without control characters.
    """
    from cageik_cli.util.outputs import write_bytes

    data = view.encode() if isinstance(view, str) else view
    if str(target) == "-":
        is_shown = sys.stdout is not None and sys.stdout.isatty()
        click.echo(view if is_shown else data, nl=False)
    else:
        write_bytes(target, data, overwrite)


def _remember_verbosity(ctx: click.Context, param: click.Parameter, value: int) -> None:
    ctx.find_root().meta["verbosity"] = value
