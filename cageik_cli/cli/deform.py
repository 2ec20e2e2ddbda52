"""`cageik deform`: the cage animation of a result applied to a mesh."""

from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.options.clip import (
    clip_options,
    pop_clip_settings,
    pop_scene_hints,
    scene_options,
)
from cageik_cli.cli.options.common import (
    PATH_TYPE,
    animation_options,
    choose_cache_folder,
    common_options,
    jobs_option,
    memory_option,
    rebinding_options,
)


@click.command("deform")
@click.argument("result", type=PATH_TYPE)
@click.option(
    "--mesh", type=PATH_TYPE, help="Another mesh in the rest cage.  [default: the rest model]"
)
@click.option(
    "--cages",
    help="Cages edited elsewhere: a folder, a quoted glob, or one file.  [default: the result's]",
)
@click.option(
    "-o",
    "--output",
    "out",
    type=PATH_TYPE,
    required=True,
    help="A file, a folder, or files in a folder by a pattern, such as mesh/mesh_####.obj.",
)
@clip_options
@scene_options
@rebinding_options
@animation_options
@memory_option
@jobs_option
@common_options
def deform_command(result: Path, quiet: bool, **options: Any) -> None:
    """Write the animation of a mesh that the cages of RESULT move, in the format of its suffix.

    It is a file (.npz, .pc2, .mdd, .glb, .usd*, .abc), a folder of frames (.obj, .ply), or such
    files by a pattern. --frames, --layout and --allow-gaps say how --cages are taken.
    """
    settings = _make_settings(result, options)

    from cageik_cli.cli.progress import show_progress
    from cageik_cli.formats.open import list_input_files
    from cageik_cli.util.outputs import check_no_overlap
    from cageik_cli.util.text import format_block
    from cageik_cli.workflows.deform import deform

    cages = list_input_files([settings.cages]) if settings.cages is not None else []
    check_no_overlap([settings.output.place], [result, settings.mesh, *cages])
    with show_progress(not quiet, None, False) as progress:
        summary = deform(settings, progress)
    if not quiet:
        click.echo(format_block(summary.message, progress.notes), err=True)


def _make_settings(result: Path, options: dict[str, Any]) -> Any:
    """The settings that the options mean; values that contradict are wrong usage."""
    from cageik_cli.formats.base.sequence import ClipSettings
    from cageik_cli.formats.write import Output
    from cageik_cli.workflows.deform import DeformSettings

    clip, scene = pop_clip_settings(options), pop_scene_hints(options)
    if options["cages"] is None and clip != ClipSettings():
        raise click.UsageError("--frames, --layout and --allow-gaps are for --cages; give a clip")
    output = Output(*(options.pop(name) for name in ("out", "kind", "overwrite")))
    options["cache"] = choose_cache_folder(options["cache"], options.pop("no_cache"))
    return DeformSettings(result, output, clip=clip, scene=scene, **options)
