"""`cageik export`: the cage animation of a result in another format."""

from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.options.clip import pop_scene_hints, scene_options
from cageik_cli.cli.options.common import PATH_TYPE, animation_options, common_options


@click.command("export")
@click.argument("result", type=PATH_TYPE)
@click.argument("out", type=PATH_TYPE)
@scene_options
@click.option(
    "--skeleton",
    is_flag=True,
    help="Write the rest pose skinned to a joint a cage vertex (.usd*).",
)
@click.option(
    "--max-influences",
    type=click.IntRange(min=1),
    help="Joints that may move a vertex at most, with --skeleton.  [default: all]",
)
@animation_options
@common_options
def export_command(result: Path, out: Path, quiet: bool, **options: Any) -> None:
    """Write the cage animation of RESULT in the format of OUT's suffix.

    OUT is a file (.npz, .pc2, .mdd, .glb, .usd*, .abc), a folder of frames (.obj, .ply), or such
    files by a pattern, cage/cage_####.obj.
    """
    if options["max_influences"] is not None and not options["skeleton"]:
        raise click.UsageError("--max-influences is for --skeleton; give both, or neither")
    scene = pop_scene_hints(options)

    from cageik_cli.cli.progress import show_progress
    from cageik_cli.formats.write import Output
    from cageik_cli.util.outputs import check_no_overlap
    from cageik_cli.util.text import format_block
    from cageik_cli.workflows.export import ExportSettings, export

    output = Output(out, options.pop("kind"), options.pop("overwrite"))
    check_no_overlap([output.target_path], [result])
    with show_progress(not quiet, None, False) as progress:
        summary = export(ExportSettings(result, output, scene, **options), progress)
    if not quiet:
        click.echo(format_block(summary.message, progress.notes), err=True)
