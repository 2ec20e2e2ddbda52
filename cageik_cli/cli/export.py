"""`cageik export`: the cage animation of a result in another format."""

from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.options.clip import scene_of, scene_options
from cageik_cli.cli.options.common import PATH, animation_options, common


@click.command("export")
@click.argument("result", type=PATH)
@click.argument("out", type=PATH)
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
@common
def export_command(result: Path, out: Path, quiet: bool, **options: Any) -> None:
    """Write the cage animation of RESULT in the format of OUT's suffix.

    OUT is a file (.npz, .pc2, .mdd, .glb, .usd*, .abc), a folder of frames (.obj, .ply), or such
    files by a pattern, cage/cage_####.obj.
    """
    if options["max_influences"] is not None and not options["skeleton"]:
        raise click.UsageError("--max-influences is for --skeleton; give both, or neither")
    scene = scene_of(options)

    from cageik_cli.cli.progress import watched
    from cageik_cli.formats.write import Output
    from cageik_cli.util.outputs import keep_apart
    from cageik_cli.util.text import page
    from cageik_cli.workflows.export import ExportSettings, export

    output = Output(out, options.pop("kind"), options.pop("overwrite"))
    keep_apart([output.place], [result])
    with watched(not quiet, None, False) as watch:
        written = export(ExportSettings(result, output, scene, **options), watch)
    if not quiet:
        click.echo(page(written.line, watch.remarks), err=True)
