"""`cageik deform`: the cage animation of a result applied to a mesh."""

from typing import TYPE_CHECKING, Any

import click

from cageik_cli.cli.command import GroupedCommand, HelpGroup, get_verbosity, option
from cageik_cli.cli.options import (
    CACHE_OPTIONS,
    PATH_TYPE,
    OptionGroup,
    common_options,
    jobs_option,
    make_binding_options,
    memory_option,
    negate,
    output_options,
    refuse_options,
)
from cageik_cli.cli.options.clip import (
    CLIP_OPTIONS,
    MORPH_MEMBERS,
    SCENE_OPTIONS,
    check_morph_usage,
    make_given_option,
    make_morph_settings,
    to_option,
)
from cageik_cli.cli.options.types import JOINTS_TYPE
from cageik_cli.formats.settings import MorphSettings

if TYPE_CHECKING:
    from cageik_cli.run.deform import DeformSettings


def make_deform_settings(**values: Any) -> "DeformSettings":
    """Make the settings of a run; values that contradict each other are wrong usage."""
    from cageik_cli.run.deform import DeformSettings

    if values["cages"] is None:
        of_cages = ("selection", "layout", "allow_gaps", "close_gaps")
        refuse_options(of_cages, "{} is for the clip of --cages; leave it out, or give --cages")
        if not values["mesh"]:
            said = "{} is for --mesh and --cages; leave it out, or give one of them"
            refuse_options(("exclude",), said)
    if values["influences"] is None:
        refuse_options(("joints",), "{} needs --influences; give both, or neither")
    has_morphs = values["morphs"] != MorphSettings(has_normals=True)
    check_morph_usage("--morphs, --tolerance and --flat", has_morphs, values["output"].path)
    return DeformSettings(compares=get_verbosity() > 0, **values)


@click.command("deform", cls=GroupedCommand)
@OptionGroup(
    "settings",
    make_deform_settings,
    click.argument("source", metavar="RESULT", type=PATH_TYPE),
    option(
        "--mesh",
        type=PATH_TYPE,
        multiple=True,
        help="Another mesh in the rest cage, or points or Gaussian splats (.ply); meshes may be "
        "repeated, and are parts of what is written.  [default: the rest model]",
    ),
    option(
        "--cages",
        help="Cages from elsewhere, such as edited ones: a folder, a quoted glob, or one file.  "
        "[default: those of the result]",
    ),
    OptionGroup(
        "output",
        "formats.write.Output",
        option(
            "-o",
            "--output",
            "path",
            type=PATH_TYPE,
            required=True,
            metavar="OUT",
            help="A file, a folder, or files in a folder, such as mesh/mesh_####.obj; {part} in "
            "the name stands for that of each part.",
        ),
        *output_options,
    ),
    CLIP_OPTIONS,
    SCENE_OPTIONS,
    to_option,
    make_given_option("--mesh and --cages", "RESULT"),
    *make_binding_options(None),
    CACHE_OPTIONS,
    option(
        "--influences",
        type=click.IntRange(min=1),
        help="Fit the weights again to the motion of the mesh, with at most this number of cage "
        "vertices per vertex, as export --skeleton does.  [default: the weights of the mesh]",
        group=HelpGroup.WRITTEN,
    ),
    option(
        "--joints",
        type=JOINTS_TYPE,
        default="turn",
        show_default=True,
        metavar="turn|translate|N",
        help="With --influences: move the mesh by joints that turn, by joints that only translate, "
        "or by N that turn.",
        group=HelpGroup.WRITTEN,
    ),
    OptionGroup(
        "morphs",
        make_morph_settings,
        *MORPH_MEMBERS,
        OptionGroup(
            "has_normals",
            negate,
            option(
                "--flat",
                is_flag=True,
                help="Leave out normals: half the size, and programs show facets (.glb).",
            ),
        ),
        group=HelpGroup.WRITTEN,
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
    --frames, --layout, --allow-gaps and --close-gaps apply to --cages, and --exclude to parts of
    --mesh and --cages.
    """
    from cageik_cli.cli.output import format_told, show_progress
    from cageik_cli.run.deform import deform

    with show_progress(not quiet, None, False) as progress:
        summary = deform(settings, progress)
    if not quiet:
        click.echo(format_told(summary.message, progress.notes, deform_command), err=True)
