"""Options that commands share."""

import os
from dataclasses import fields
from pathlib import Path

import click

from cageik_cli.cli.command import option
from cageik_cli.cli.config import apply_config
from cageik_cli.cli.options.group import PATH_TYPE, Command, OptionGroup, is_on_command_line
from cageik_cli.cli.options.types import FrameFormatType
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.util.settings import HelpGroup, Setting


def common_options(command: Command) -> Command:
    """Add -v, -q and --config."""
    for add_option in (
        option(
            "--config",
            type=PATH_TYPE,
            is_eager=True,
            expose_value=False,
            callback=apply_config,
            is_per_clip=False,
            help="TOML file with options under [COMMAND]; the command line wins.",
            group=HelpGroup.RUNNING,
        ),
        option(
            "-q",
            "--quiet",
            is_flag=True,
            is_per_clip=False,
            help="Print only errors and exceeded limits.",
            group=HelpGroup.RUNNING,
        ),
        option(
            "-v",
            "--verbose",
            count=True,
            expose_value=False,
            callback=_remember_verbosity,
            is_per_clip=False,
            help="Print more; -vv prints the traceback of an error.",
            group=HelpGroup.RUNNING,
        ),
    ):
        add_option(command)
    return command


def _remember_verbosity(ctx: click.Context, param: click.Parameter, value: int) -> None:
    ctx.find_root().meta["verbosity"] = value


def count_processors() -> int:
    """Return how many processors this process may use; the module that knows is slow to import."""
    from cageik_cli.util.threads import count_processors

    return count_processors()


jobs_option = option(
    "--jobs",
    type=click.IntRange(min=1),
    default=count_processors,
    show_default="processors",
    is_per_clip=False,
    help="Number of threads, or of processes.",
    group=HelpGroup.RUNNING,
)


timings_option = option(
    "--timings",
    type=PATH_TYPE,
    is_per_clip=False,
    help="Write the seconds of each stage to this JSON file.",
    group=HelpGroup.RUNNING,
)


json_option = option(
    "--json", "json_path", type=PATH_TYPE, help="Write the record as JSON; - is stdout."
)


overwrite_option = option("--overwrite", is_flag=True, help="Replace existing outputs.")


output_options = (
    option(
        "--format",
        "file_format",
        type=FrameFormatType(),
        metavar="[obj|ply]",
        help="File format when OUT is a folder.  [default: obj]",
        group=HelpGroup.WRITTEN,
    ),
    option(
        "--recentre",
        is_flag=True,
        help="Move the animation to the origin, and write the offset beside it (OUT.offset.json).",
        group=HelpGroup.WRITTEN,
    ),
    overwrite_option,
)
"""Options of an animation that is written."""


def choose_cache_folder(cache: Path | None, no_cache: bool) -> Path | None:
    """Return the folder of the cache; None for none.

    The command line comes before the file of options, then the environment, then the folder of
    the user.
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
    option(
        "--cache",
        type=PATH_TYPE,
        setting=Setting("", role="written"),
        help="Folder of the cache of weights and built cages.  [default: CAGEIK_CACHE, or the "
        "cache folder of the user]",
    ),
    option("--no-cache", is_flag=True, help="Do not use the cache."),
    group=HelpGroup.RUNNING,
)


WEIGHT_NAMES = (*(one.name for one in fields(BindSettings)), "cache", "no_cache", "jobs")
"""The options of weights, which some targets bring."""
