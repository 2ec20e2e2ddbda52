"""`cageik export`: the cage animation of a result in another format."""

from typing import TYPE_CHECKING, Any

import click

from cageik_cli.cli.command import GroupedCommand, get_verbosity, option
from cageik_cli.cli.options import (
    PATH_TYPE,
    OptionGroup,
    common_options,
    output_options,
    refuse_options,
)
from cageik_cli.cli.options.clip import MORPH_OPTIONS, SCENE_OPTIONS, check_morph_usage, to_option
from cageik_cli.cli.options.types import JOINTS_TYPE
from cageik_cli.formats.settings import ROOT_MOTIONS, MorphSettings

if TYPE_CHECKING:
    from cageik_cli.run.export import ExportSettings


def make_export_settings(**values: Any) -> "ExportSettings":
    """Make the settings of an export; values that contradict each other are wrong usage."""
    from cageik_cli.run.export import ExportSettings

    is_skeleton = values["skeleton"]
    if values["influences"] is not None and not is_skeleton:
        raise click.UsageError("--influences needs --skeleton; give both, or neither")
    if not is_skeleton:
        only = ("joints", "root_motion", "quantize")
        refuse_options(only, "{} needs --skeleton; give both, or neither")
    if values["guide"] and not values["with_model"]:
        raise click.UsageError("--guide needs --with-model; give both, or neither")
    if values["morphs"].count is not None and is_skeleton:
        raise click.UsageError(
            "--morphs does not go with --skeleton, which has none; give --influences"
        )
    has_morphs = values["morphs"] != MorphSettings()
    check_morph_usage("--morphs and --tolerance", has_morphs, values["output"].path)
    return ExportSettings(compares=get_verbosity() > 0, **values)


@click.command("export", cls=GroupedCommand)
@OptionGroup(
    "settings",
    make_export_settings,
    click.argument("result", type=PATH_TYPE),
    OptionGroup(
        "output",
        "formats.write.Output",
        click.argument("path", metavar="OUT", type=PATH_TYPE),
        *output_options,
    ),
    SCENE_OPTIONS,
    to_option,
    option(
        "--skeleton",
        is_flag=True,
        help="Write the rest pose with one joint per cage vertex and the weights as skin weights "
        "(.usd*, .glb).",
    ),
    option(
        "--influences",
        type=click.IntRange(min=1),
        help="Fit the weights again, with at most this number of joints per vertex.  [default: "
        "the weights of the result]",
    ),
    option(
        "--joints",
        type=JOINTS_TYPE,
        default="turn",
        show_default=True,
        metavar="turn|translate|N",
        help="Joints that turn, which programs shade rightly, or that only translate: one per cage "
        "vertex. Or N that turn, into which those are merged; with 4 influences if none are given.",
    ),
    option(
        "--root-motion",
        type=click.Choice(ROOT_MOTIONS),
        default="keep",
        show_default=True,
        help="With --skeleton: the root moves as the whole body, or along the ground, and turns "
        "about the vertical only.",
    ),
    option(
        "--quantize",
        is_flag=True,
        help="With --skeleton: write integers of 8 and 16 bits where they are enough (.glb).",
    ),
    option(
        "--with-model",
        is_flag=True,
        help="Write the cage and the model that it moves in one file (.usd*, .abc, .glb, .obj). "
        "With --skeleton, the model is skinned.",
    ),
    option(
        "--guide",
        is_flag=True,
        help="Give the cage of --with-model the purpose `guide`, which programs hide and do not "
        "render (.usd*).",
    ),
    MORPH_OPTIONS,
)
@common_options
def export_command(settings: "ExportSettings", quiet: bool) -> None:
    """Convert a cage animation to other formats.

    The cages of RESULT are written to OUT, whose suffix is the format: a file (.npz, .pc2, .mdd,
    .glb, .usd*, .abc), a folder of frames (.obj, .ply), or numbered files in a folder, such as
    cage/cage_####.obj.
    """
    from cageik_cli.cli.output import format_told, show_progress
    from cageik_cli.run.export import export
    from cageik_cli.util.outputs import check_no_overlap

    check_no_overlap(settings.outputs(), settings.inputs())
    with show_progress(not quiet, None, False) as progress:
        summary = export(settings, progress)
    if not quiet:
        click.echo(format_told(summary.message, progress.notes, export_command), err=True)
