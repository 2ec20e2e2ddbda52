"""`cageik bind`: the weights of a rest pose in a cage."""

from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.options.common import (
    PATH_TYPE,
    binding_options,
    choose_cache_folder,
    common_options,
    get_verbosity,
    jobs_option,
    timings_option,
)


@click.command("bind")
@click.option("--cage", type=PATH_TYPE, required=True, help="The cage around the rest pose.")
@click.option("--rest", type=PATH_TYPE, required=True, help="The rest pose.")
@click.option(
    "-o",
    "--output",
    type=PATH_TYPE,
    default="binding.h5",
    show_default=True,
    help="The binding file.",
)
@binding_options
@click.option("--overwrite", is_flag=True, help="Replace an existing binding.")
@timings_option
@jobs_option
@common_options
def bind_command(timings: Path | None, quiet: bool, **options: Any) -> None:
    """Compute the weights that tie a rest pose to its cage, for `cageik extract --binding`."""
    settings = _make_settings(options)

    from cageik_cli.cli.progress import show_progress
    from cageik_cli.util.outputs import check_no_overlap
    from cageik_cli.util.text import format_block
    from cageik_cli.workflows.bind import bind_files
    from cageik_cli.workflows.info import format_binding_rows

    output = settings.output
    check_no_overlap([output, timings], [settings.cage, settings.rest])
    with show_progress(not quiet, timings, settings.overwrite) as progress:
        stored = bind_files(settings, progress)
    if not quiet:
        click.echo(
            format_block(str(output), [*format_binding_rows(stored), *progress.make_rows()]),
            err=True,
        )
        click.echo(f"wrote {output}; next: cageik extract FRAMES --binding {output}", err=True)
    if get_verbosity():
        click.echo(f"cache: {settings.weights.cache}", err=True)


def _make_settings(options: dict[str, Any]) -> Any:
    """The settings that the options mean."""
    from cageik_cli.coordinates.binding import BindSettings
    from cageik_cli.workflows.bind import BindRunSettings, WeightSettings

    bind = BindSettings(*(options.pop(name) for name in ("coordinates", "accuracy", "outside")))
    cache = choose_cache_folder(options.pop("cache"), options.pop("no_cache"))
    return BindRunSettings(weights=WeightSettings(bind, cache, options.pop("jobs")), **options)
