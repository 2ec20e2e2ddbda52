"""`cageik export`: the cage animation of a result in another format."""

from typing import Any

import click

from cageik_cli.cli.command import GroupedCommand, get_verbosity
from cageik_cli.cli.options import (
    CACHE_OPTIONS,
    common_options,
    output_options,
)
from cageik_cli.cli.options.group import PATH_TYPE, OptionGroup, list_options
from cageik_cli.run.settings import ExportSettings


def make_export_settings(**values: Any) -> ExportSettings:
    """Make the settings of an export."""
    return ExportSettings(compares=get_verbosity() > 0, **values)


@click.command("export", cls=GroupedCommand)
@OptionGroup(
    "settings",
    make_export_settings,
    *list_options(
        ExportSettings,
        output=OptionGroup(
            "output",
            "formats.write.Output",
            click.argument("path", metavar="OUT", type=PATH_TYPE),
            *output_options,
        ),
        cache=CACHE_OPTIONS,
    ),
)
@common_options
def export_command(settings: ExportSettings, quiet: bool) -> None:
    """Convert a cage animation to other formats.

    The cages of a result are written to OUT, whose suffix is the format: a file (.npz, .pc2, .mdd,
    .glb, .usd*, .abc), a folder of frames (.obj, .ply) or of textures (.vat), or numbered files
    in a folder, such as cage/cage_####.obj. With --skeleton, several results are the animations
    of one model.
    """
    from cageik_cli.cli.output import format_command_output, show_progress
    from cageik_cli.run.export import export
    from cageik_cli.util.outputs import check_no_overlap

    check_no_overlap(settings.outputs(), settings.inputs())
    with show_progress(not quiet, None, False) as progress:
        summary = export(settings, progress)
    if not quiet:
        rows = progress.make_rows() if get_verbosity() else progress.notes
        click.echo(format_command_output(summary.message, rows, export_command), err=True)
