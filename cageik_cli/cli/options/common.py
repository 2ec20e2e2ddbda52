"""Options that several commands share, and the types of their values."""

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click
from click.core import ParameterSource

from cageik_cli.cli.config import apply_config
from cageik_cli.util.threads import count_processors

Command = TypeVar("Command", bound=Callable[..., Any])
PATH_TYPE = click.Path(path_type=Path)

# The numerics' own words, which would take a second to import; a test compares them.
COORDINATES = ("harmonic", "mean-value")

ACCURACIES = {"preview": 0.03, "standard": 0.005, "fine": 0.001}
OUTSIDE_POLICIES = ("refuse", "project")
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
    """-v, -q and --config."""
    for option in (
        click.option(
            "--config",
            type=PATH_TYPE,
            is_eager=True,
            expose_value=False,
            callback=apply_config,
            help="A TOML file with options under [COMMAND]; the command line wins.",
        ),
        click.option(
            "-q", "--quiet", is_flag=True, help="Say nothing but errors, and what is over a limit."
        ),
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


def jobs_option(command: Command) -> Command:
    """--jobs."""
    return click.option(
        "--jobs",
        type=click.IntRange(min=1),
        default=count_processors,
        show_default="processors",
        help="Threads.",
    )(command)


def timings_option(command: Command) -> Command:
    """--timings."""
    return click.option(
        "--timings", type=PATH_TYPE, help="Write the seconds of each stage to this JSON file."
    )(command)


def binding_options(command: Command) -> Command:
    """--coordinates, --accuracy, --outside, --cache and --no-cache: how weights come about."""
    return _add_binding_options(command, (COORDINATES[0], "standard", OUTSIDE_POLICIES[0]))


def rebinding_options(command: Command) -> Command:
    """The same options, where there is a result whose own settings hold unless others are given."""
    return _add_binding_options(command, (None, None, None))


def _add_binding_options(command: Command, defaults: tuple[str | None, ...]) -> Command:
    coordinates, accuracy, outside = map(_make_default, defaults)
    tolerances = ", ".join(f"{error} {name}" for name, error in ACCURACIES.items())
    for option in (
        click.option("--no-cache", is_flag=True, help="Compute the weights, and do not keep them."),
        click.option(
            "--cache",
            type=PATH_TYPE,
            help="The folder that keeps weights.  [default: CAGEIK_CACHE, or the user's caches]",
        ),
        click.option(
            "--outside",
            type=click.Choice(OUTSIDE_POLICIES),
            help="What to do with vertices outside the cage; projected ones take the weights of "
            "the nearest point of the cage.",
            **outside,
        ),
        click.option(
            "--accuracy",
            type=click.Choice(list(ACCURACIES)),
            help=f"Mean over vertices of the error of a row of weights, summed: {tolerances}.",
            **accuracy,
        ),
        click.option(
            "--coordinates",
            type=click.Choice(COORDINATES),
            help="What the weights are.",
            **coordinates,
        ),
    ):
        command = option(command)
    return command


def _make_default(value: str | None) -> dict[str, Any]:
    return {"default": value, "show_default": value or "the result's"}


def memory_option(command: Command) -> Command:
    """--memory."""
    return click.option(
        "--memory",
        type=SizeType(),
        default="1GiB",
        show_default=True,
        help="Most for the weights and blocks of frames.",
    )(command)


def animation_options(command: Command) -> Command:
    """--format and --overwrite: how an animation is written."""
    for option in (
        click.option("--overwrite", is_flag=True, help="Replace what is there."),
        click.option(
            "--format",
            "kind",
            type=FrameFormatType(),
            metavar="[obj|ply]",
            help="Of the files in a folder that is but named.  [default: obj]",
        ),
    ):
        command = option(command)
    return command


def is_on_command_line(name: str) -> bool:
    """Whether an option was given on the command line."""
    source = click.get_current_context().get_parameter_source(name)
    return source is ParameterSource.COMMANDLINE


def choose_cache_folder(cache: Path | None, no_cache: bool) -> Path | None:
    """The folder of the cache: of the command line, the file of options, the environment, the user.

    Raises
    ------
    click.UsageError
        When the command line both names and refuses one.
    """
    if is_on_command_line("cache") and is_on_command_line("no_cache"):
        raise click.UsageError("--cache and --no-cache exclude each other; give one")
    if no_cache and not is_on_command_line("cache"):
        return None
    named = cache or os.environ.get("CAGEIK_CACHE")
    if named:
        return Path(named)

    from platformdirs import user_cache_path

    return user_cache_path("cageik", appauthor=False)


def get_verbosity() -> int:
    """How many -v were given."""
    return int(click.get_current_context().find_root().meta.get("verbosity", 0))


def write_or_print(view: str | bytes, target: Path, overwrite: bool) -> None:
    """Write to a file, or to stdout for the name `-`."""
    from cageik_cli.util.outputs import write_bytes

    if str(target) == "-":
        click.echo(view, nl=False)
    else:
        write_bytes(target, view.encode() if isinstance(view, str) else view, overwrite)


def _remember_verbosity(ctx: click.Context, param: click.Parameter, value: int) -> None:
    ctx.find_root().meta["verbosity"] = value
