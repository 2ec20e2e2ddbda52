"""`cageik bind`: the weights of a rest pose in a cage."""

from dataclasses import fields
from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.command import GroupedCommand, get_verbosity
from cageik_cli.cli.options import CACHE_OPTIONS, common_options, jobs_option, timings_option
from cageik_cli.cli.options.group import OptionGroup, is_given, list_options
from cageik_cli.cli.options.solve import make_fit_settings, refuse_without_fit
from cageik_cli.fit.settings import FitSettings
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.run.settings import BindRunSettings


def make_bind_settings(fit: FitSettings | None, **others: Any) -> BindRunSettings:
    """Make the settings of a run; options of a fit without one are wrong usage."""
    if fit is None:
        refuse_without_fit(("vertex_weights", *(one.name for one in fields(SolveSettings)), "fps"))
    return BindRunSettings(fit=fit or FitSettings(), **others)


def make_clip_fit(**options: Any) -> FitSettings | None:
    """Make the settings of a fit to clips; None without clips."""
    return make_fit_settings(is_given("clips"), **options)


@click.command("bind", cls=GroupedCommand)
@OptionGroup(
    "settings",
    make_bind_settings,
    *list_options(
        BindRunSettings,
        cache=CACHE_OPTIONS,
        jobs=jobs_option,
        fit=OptionGroup("fit", make_clip_fit, *list_options(FitSettings)),
    ),
)
@timings_option
@common_options
def bind_command(settings: BindRunSettings, timings: Path | None, quiet: bool) -> None:
    """Compute and save the weights of a model.

    `cageik extract --binding` and `cageik pose` take the binding file.

    \b
    cageik bind --cage cage.obj --rest rest.obj --fit walk --fit run -o hero.h5
    """  # noqa: D301
    from cageik_cli.cli.output import format_command_output, show_progress
    from cageik_cli.run.bind import bind_files
    from cageik_cli.run.info import format_binding_rows
    from cageik_cli.util.outputs import check_no_overlap

    output = settings.output
    check_no_overlap([*settings.outputs(), timings], settings.inputs())
    with show_progress(not quiet, timings, settings.overwrite) as progress:
        stored = bind_files(settings, progress)
    if not quiet:
        rows = [*format_binding_rows(stored, bool(get_verbosity())), *progress.make_rows()]
        if not get_verbosity():  # how close a fit is comes before how it was computed
            rows.sort(key=lambda row: row[0] in ("settings", "weights", "accuracy"))
        click.echo(format_command_output(str(output), rows, bind_command), err=True)
        click.echo(f"wrote {output}; next: cageik extract FRAMES --binding {output}", err=True)
    if get_verbosity():
        click.echo(f"cache: {settings.weights.cache}", err=True)
