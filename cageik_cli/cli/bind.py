"""`cageik bind`: the weights of a rest pose in a cage."""

from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.options.common import (
    PATH,
    binding_options,
    cache_folder,
    common,
    jobs,
    timings_option,
    verbosity,
)


@click.command("bind")
@click.option("--cage", type=PATH, required=True, help="The cage around the rest pose.")
@click.option("--rest", type=PATH, required=True, help="The rest pose.")
@click.option(
    "-o", "--output", type=PATH, default="binding.h5", show_default=True, help="The binding file."
)
@binding_options
@click.option("--overwrite", is_flag=True, help="Replace an existing binding.")
@timings_option
@jobs
@common
def bind_command(timings: Path | None, quiet: bool, **options: Any) -> None:
    """Compute the weights that tie a rest pose to its cage, for `cageik extract --binding`."""
    settings = _settings(options)

    from cageik_cli.cli.progress import watched
    from cageik_cli.util.outputs import keep_apart
    from cageik_cli.util.text import page
    from cageik_cli.workflows.bind import bind_files
    from cageik_cli.workflows.info import binding_rows

    output = settings.output
    keep_apart([output, timings], [settings.cage, settings.rest])
    with watched(not quiet, timings, settings.overwrite) as watch:
        stored = bind_files(settings, watch)
    if not quiet:
        click.echo(page(str(output), [*binding_rows(stored), *watch.rows()]), err=True)
        click.echo(f"wrote {output}; next: cageik extract FRAMES --binding {output}", err=True)
    if verbosity():
        click.echo(f"cache: {settings.weights.cache}", err=True)


def _settings(options: dict[str, Any]) -> Any:
    """The settings that the options mean."""
    from cageik_cli.coordinates.binding import BindSettings
    from cageik_cli.workflows.bind import BindRunSettings, WeightSettings

    bind = BindSettings(*(options.pop(name) for name in ("coordinates", "accuracy", "outside")))
    cache = cache_folder(options.pop("cache"), options.pop("no_cache"))
    return BindRunSettings(weights=WeightSettings(bind, cache, options.pop("jobs")), **options)
