"""`cageik deform`: the cage animation of a result applied to a mesh."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cageik_cli.cli.options.clip import CLIP_OPTIONS, SCENE_OPTIONS
from cageik_cli.cli.options.common import (
    CACHE_OPTIONS,
    PATH_TYPE,
    common_options,
    format_option,
    get_verbosity,
    jobs_option,
    make_binding_options,
    memory_option,
    overwrite_option,
    recentre_option,
)
from cageik_cli.cli.options.group import OptionGroup
from cageik_cli.cli.options.morphs import MORPH_OPTIONS, check_morph_usage
from cageik_cli.formats.settings import ClipSettings, MorphSettings, SceneHints

if TYPE_CHECKING:
    from cageik_cli.formats.write import Output
    from cageik_cli.workflows.deform import DeformSettings


def make_output(out: Path, file_format: str | None, recentre: bool, overwrite: bool) -> "Output":
    """Make the record of an animation's output."""
    from cageik_cli.formats.write import Output

    return Output(out, file_format, overwrite, recentre)


def make_mesh_morphs(morphs: MorphSettings, flat: bool) -> MorphSettings:
    """Add to the settings of morph targets whether they have normals."""
    return replace(morphs, has_normals=not flat)


def make_deform_settings(
    source: Path,
    mesh: Path | None,
    cages: str | None,
    output: "Output",
    clip: ClipSettings,
    scene: SceneHints,
    coordinates: str | None,
    accuracy: str | None,
    outside: str | None,
    cache: Path | None,
    memory: int,
    jobs: int,
    influences: int | None,
    mesh_morphs: MorphSettings,
) -> "DeformSettings":
    """Make the settings of a run; values that contradict each other are wrong usage."""
    from cageik_cli.workflows.deform import DeformSettings

    if cages is None and clip != ClipSettings():
        raise click.UsageError(
            "--frames, --layout, --allow-gaps and --close-gaps apply to --cages; leave them out, "
            "or give it"
        )
    is_given = mesh_morphs != MorphSettings(has_normals=True)
    check_morph_usage("--morphs, --tolerance and --flat", is_given, output.path)
    return DeformSettings(
        source=source,
        output=output,
        mesh=mesh,
        coordinates=coordinates,
        accuracy=accuracy,
        outside=outside,
        cages=cages,
        clip=clip,
        scene=scene,
        cache=cache,
        memory=memory,
        jobs=jobs,
        influences=influences,
        compares=influences is not None and get_verbosity() > 0,
        morphs=mesh_morphs,
    )


@click.command("deform")
@OptionGroup(
    "settings",
    make_deform_settings,
    click.argument("source", metavar="RESULT", type=PATH_TYPE),
    click.option(
        "--mesh",
        type=PATH_TYPE,
        help="Another mesh in the rest cage, or points or Gaussian splats (.ply).  "
        "[default: the rest model]",
    ),
    click.option(
        "--cages",
        help="Cages from elsewhere, such as edited ones: a folder, a quoted glob, or one file.  "
        "[default: those of the result]",
    ),
    OptionGroup(
        "output",
        make_output,
        click.option(
            "-o",
            "--output",
            "out",
            type=PATH_TYPE,
            required=True,
            metavar="OUT",
            help="A file, a folder, or files in a folder, such as mesh/mesh_####.obj.",
        ),
        format_option,
        recentre_option,
        overwrite_option,
    ),
    CLIP_OPTIONS,
    SCENE_OPTIONS,
    *make_binding_options(None),
    CACHE_OPTIONS,
    click.option(
        "--influences",
        type=click.IntRange(min=1),
        help="Fit the weights again to the motion of the mesh, with at most this number of cage "
        "vertices per vertex, as export --skeleton does.  [default: the weights of the mesh]",
    ),
    OptionGroup(
        "mesh_morphs",
        make_mesh_morphs,
        MORPH_OPTIONS,
        click.option(
            "--flat",
            is_flag=True,
            help="Leave out normals: half the size, and programs show facets (.glb).",
        ),
    ),
    memory_option,
    jobs_option,
)
@common_options
def deform_command(settings: "DeformSettings", quiet: bool) -> None:
    """Move a mesh, points or splats by cages.

    The cages of RESULT move its rest model, or another mesh. With --cages, RESULT may also be
    a binding. The suffix of OUT is the format: a file (.npz, .pc2, .mdd, .glb, .usd*, .abc), a
    folder of frames (.obj, .ply), or numbered files in a folder. Points are written as .ply (the
    default), .npz, .pc2 or .mdd, and splats as .ply (the default) or .usd*.
    --frames, --layout, --allow-gaps and --close-gaps apply to --cages.
    """
    from cageik_cli.cli.progress import show_progress
    from cageik_cli.util.text import format_block
    from cageik_cli.workflows.deform import deform

    with show_progress(not quiet, None, False) as progress:
        summary = deform(settings, progress)
    if not quiet:
        click.echo(format_block(summary.message, progress.notes), err=True)
