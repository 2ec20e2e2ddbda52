"""`cageik deform`: the cage animation of a result applied to a mesh."""

from typing import Any

import click

from cageik_cli.cli.command import GroupedCommand, get_verbosity, option
from cageik_cli.cli.options import (
    CACHE_OPTIONS,
    common_options,
    jobs_option,
    output_options,
)
from cageik_cli.cli.options.group import PATH_TYPE, OptionGroup, list_options
from cageik_cli.run.settings import DeformSettings


def make_deform_settings(**values: Any) -> DeformSettings:
    """Make the settings of a run."""
    return DeformSettings(compares=get_verbosity() > 0, **values)


@click.command("deform", cls=GroupedCommand)
@OptionGroup(
    "settings",
    make_deform_settings,
    *list_options(
        DeformSettings,
        output=OptionGroup(
            "output",
            "formats.write.Output",
            option(
                "-o",
                "--output",
                "path",
                type=PATH_TYPE,
                required=True,
                metavar="OUT",
                help="A file, a folder, or files in a folder, such as mesh/mesh_####.obj; {part} "
                "in the name stands for that of each part.",
            ),
            *output_options,
        ),
        cache=CACHE_OPTIONS,
        jobs=jobs_option,
    ),
)
@common_options
def deform_command(settings: DeformSettings, quiet: bool) -> None:
    """Move a mesh, points or splats by cages.

    The cages of RESULT move its rest model, or another mesh. With --cages, RESULT may also be
    a binding. The suffix of OUT is the format: a file (.npz, .pc2, .mdd, .glb, .usd*, .abc), a
    folder of textures for shaders (.vat) or of frames (.obj, .ply), or numbered files in a
    folder. Points are written as .ply (the default), .npz, .pc2 or .mdd, and splats as .ply (the
    default) or .usd*.
    --frames, --layout, --allow-gaps and --close-gaps apply to --cages, and --exclude to parts of
    --mesh and --cages.
    """
    from cageik_cli.cli.output import format_command_output, show_progress
    from cageik_cli.run.deform import deform

    with show_progress(not quiet, None, False) as progress:
        summary = deform(settings, progress)
    if not quiet:
        click.echo(format_command_output(summary.message, progress.notes, deform_command), err=True)
