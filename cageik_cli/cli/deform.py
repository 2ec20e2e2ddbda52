"""`cageik deform`: the cage animation of a result applied to a mesh."""

from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.options.clip import clip_of, clip_options, scene_of, scene_options
from cageik_cli.cli.options.common import (
    PATH,
    animation_options,
    cache_folder,
    common,
    jobs,
    memory_option,
    rebinding_options,
)


@click.command("deform")
@click.argument("result", type=PATH)
@click.option("--mesh", type=PATH, help="Another mesh in the rest cage.  [default: the rest model]")
@click.option(
    "--cages",
    help="Cages edited elsewhere: a folder, a quoted glob, or one file.  [default: the result's]",
)
@click.option(
    "-o",
    "--output",
    "out",
    type=PATH,
    required=True,
    help="A file, a folder, or files in a folder by a pattern, such as mesh/mesh_####.obj.",
)
@clip_options
@scene_options
@rebinding_options
@animation_options
@memory_option
@jobs
@common
def deform_command(result: Path, quiet: bool, **options: Any) -> None:
    """Write the animation of a mesh that the cages of RESULT move, in the format of its suffix.

    It is a file (.npz, .pc2, .mdd, .glb, .usd*, .abc), a folder of frames (.obj, .ply), or such
    files by a pattern. --frames, --layout and --allow-gaps say how --cages are taken.
    """
    settings = _settings(result, options)

    from cageik_cli.cli.progress import watched
    from cageik_cli.formats.open import files_read
    from cageik_cli.util.outputs import keep_apart
    from cageik_cli.util.text import page
    from cageik_cli.workflows.deform import deform

    cages = files_read([settings.cages]) if settings.cages is not None else []
    keep_apart([settings.output.place], [result, settings.mesh, *cages])
    with watched(not quiet, None, False) as watch:
        written = deform(settings, watch)
    if not quiet:
        click.echo(page(written.line, watch.remarks), err=True)


def _settings(result: Path, options: dict[str, Any]) -> Any:
    """The settings that the options mean; values that contradict are wrong usage."""
    from cageik_cli.formats.base.sequence import ClipSettings
    from cageik_cli.formats.write import Output
    from cageik_cli.workflows.deform import DeformSettings

    clip, scene = clip_of(options), scene_of(options)
    if options["cages"] is None and clip != ClipSettings():
        raise click.UsageError("--frames, --layout and --allow-gaps are for --cages; give a clip")
    output = Output(*(options.pop(name) for name in ("out", "kind", "overwrite")))
    options["cache"] = cache_folder(options["cache"], options.pop("no_cache"))
    return DeformSettings(result, output, clip=clip, scene=scene, **options)
