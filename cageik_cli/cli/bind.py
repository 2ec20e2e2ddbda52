"""`cageik bind`: the weights of a rest pose in a cage."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cageik_cli.cli.command import GroupedCommand, get_verbosity, option
from cageik_cli.cli.options import (
    PATH_TYPE,
    WEIGHT_OPTIONS,
    OptionGroup,
    common_options,
    is_given,
    memory_option,
    overwrite_option,
    timings_option,
)
from cageik_cli.cli.options.clip import exclude_option, make_given_option, rate_option
from cageik_cli.cli.options.solve import (
    FIT_STRENGTH_OPTIONS,
    SOLVE_OPTIONS,
    make_fit_settings,
    refuse_without_fit,
    vertex_weights_option,
)
from cageik_cli.fit.settings import FitSettings

if TYPE_CHECKING:
    from cageik_cli.run.bind import BindRunSettings


def make_bind_settings(fit: FitSettings | None, **others: Any) -> "BindRunSettings":
    """Make the settings of a run; options of a fit without one are wrong usage."""
    from cageik_cli.run.bind import BindRunSettings

    if fit is None:
        refuse_without_fit(("vertex_weights", "alpha", "beta", "align", "fps"))
    return BindRunSettings(fit=fit or FitSettings(), **others)


def make_clip_fit(**options: Any) -> FitSettings | None:
    """Make the settings of a fit to clips; None without clips."""
    return make_fit_settings(is_given("clips"), **options)


@click.command("bind", cls=GroupedCommand)
@OptionGroup(
    "settings",
    make_bind_settings,
    option("--cage", type=PATH_TYPE, required=True, help="The cage around the rest pose."),
    option("--rest", type=PATH_TYPE, required=True, help="Mesh of the rest pose."),
    option(
        "-o",
        "--output",
        type=PATH_TYPE,
        default="binding.h5",
        show_default=True,
        help="The binding file.",
    ),
    WEIGHT_OPTIONS,
    option(
        "--fit",
        "clips",
        metavar="CLIP",
        multiple=True,
        help="Fit the weights to this clip: a folder, a glob or a file; may be repeated.",
    ),
    OptionGroup("fit", make_clip_fit, *FIT_STRENGTH_OPTIONS),
    SOLVE_OPTIONS,
    vertex_weights_option,
    exclude_option,
    rate_option,
    make_given_option("--cage and --fit", "--rest"),
    memory_option,
    overwrite_option,
)
@timings_option
@common_options
def bind_command(settings: "BindRunSettings", timings: Path | None, quiet: bool) -> None:
    """Compute and save the weights of a model.

    `cageik extract --binding` and `cageik pose` take the binding file.

    \b
    cageik bind --cage cage.obj --rest rest.obj --fit walk --fit run -o hero.h5
    """  # noqa: D301
    from cageik_cli.cli.output import format_told, show_progress
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
        click.echo(format_told(str(output), rows, bind_command), err=True)
        click.echo(f"wrote {output}; next: cageik extract FRAMES --binding {output}", err=True)
    if get_verbosity():
        click.echo(f"cache: {settings.weights.cache}", err=True)
