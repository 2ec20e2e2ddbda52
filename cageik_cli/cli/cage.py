"""`cageik cage`: a cage around a model."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import click

from cageik_cli.cages.settings import BuildSettings, SymmetryChoice
from cageik_cli.cli.command import GroupedCommand, HelpGroup, get_verbosity, option
from cageik_cli.cli.options import (
    PATH_TYPE,
    OptionGroup,
    common_options,
    is_given,
    is_on_command_line,
    jobs_option,
    json_option,
    overwrite_option,
    refuse_options,
)
from cageik_cli.cli.options.clip import (
    SAMPLED_CLIP_OPTIONS,
    make_given_option,
    rest_frame_option,
    rest_option,
)
from cageik_cli.cli.options.types import PercentType
from cageik_cli.formats.timeline import format_frame_number

if TYPE_CHECKING:
    from cageik_cli.run.cage import CageSettings, RepairCageSettings


def make_symmetric_option(group: HelpGroup | None = None) -> Any:
    """Make the option of symmetric cages, in a group of the help."""
    return option(
        "--symmetric",
        type=click.Choice(get_args(SymmetryChoice)),
        default=BuildSettings().symmetric,
        show_default=True,
        help="Build a cage that is its own mirror image: about the plane of a model that is one "
        "(auto), or across an axis.",
        group=group,
    )


BUILD_OPTIONS = OptionGroup(
    "build",
    BuildSettings,
    option(
        "--vertices",
        type=int,
        metavar="N",
        default=BuildSettings().vertices,
        show_default=True,
        help="Vertices of the cage, at most; it has at least 0.9 times as many.",
    ),
    option(
        "--clearance",
        type=PercentType("a clearance", "0.4%", unit=100),
        default=f"{100 * BuildSettings().clearance:g}%",
        show_default=True,
        help="Smallest distance between cage and model, in percent of the diagonal.",
    ),
    make_symmetric_option(),
    option(
        "--quads",
        is_flag=True,
        help="Make quads of most triangles; the model is inside by either diagonal.",
    ),
    option(
        "--loops",
        is_flag=True,
        help="Lay loops of 4 to 6 vertices around limbs, more where they bend.",
    ),
)


def make_cage_settings(repair: Path | None, **values: Any) -> "CageSettings | RepairCageSettings":
    """Make the settings of a build or a repair; values that contradict are wrong usage."""
    from cageik_cli.run.cage import CageSettings, RepairCageSettings

    model, rest = values["model"], values["rest"]
    if repair is None:
        if model is None:
            raise click.UsageError("Missing argument 'MODEL' (or '--repair', which names a cage).")
        rest_frame = values.pop("rest_frame") if is_given("rest_frame") else None
        return CageSettings(**{**values, "rest_frame": rest_frame})
    build_names = (
        "vertices",
        "clearance",
        "symmetric",
        "quads",
        "loops",
        "rest_frame",
        "animation",
    )
    refuse_options(build_names, "--repair keeps the cage; leave out {}", is_on_command_line)
    if (model is None) == (rest is None):
        raise click.UsageError("--repair needs the model: give it with --rest, or as MODEL")
    return RepairCageSettings(
        repair,
        rest or Path(model),
        values["output"],
        given_in=values["given_in"],
        overwrite=values["overwrite"],
    )


@click.command("cage", cls=GroupedCommand)
@OptionGroup(
    "settings",
    make_cage_settings,
    click.argument("model", required=False),
    option(
        "--repair",
        type=PATH_TYPE,
        metavar="CAGE",
        help="Make this cage fit for the model instead, with as little change as possible.",
    ),
    option("-o", "--output", type=PATH_TYPE, required=True, help="The cage, an .obj file."),
    BUILD_OPTIONS,
    rest_option,
    rest_frame_option,
    option(
        "--for",
        "animation",
        multiple=True,
        metavar="FRAMES",
        help="Choose the cage with the smallest error on these frames; may be repeated.",
    ),
    SAMPLED_CLIP_OPTIONS,
    make_given_option("--repair, --for, and --rest of a clip", "the model"),
    overwrite_option,
    jobs_option,
)
@json_option
@common_options
def cage_command(
    settings: "CageSettings | RepairCageSettings", json_path: Path | None, quiet: bool
) -> None:
    """Build a cage around a model, or repair one.

    MODEL is a mesh, or a clip, of which the rest pose is taken. It may be open, have several parts
    or cross itself. The cage is closed, has one component, and encloses the whole surface.

    \b
    cageik cage body.obj -o cage.obj --vertices 150
    cageik cage body.obj -o cage.obj --for frames
    cageik cage --repair mine.obj --rest body.obj -o cage.obj
    """  # noqa: D301
    from cageik_cli.cli.output import check_views, format_told, show_progress, write_or_print
    from cageik_cli.report.views.cage import (
        format_cage_json,
        format_repair_json,
        list_cage_rows,
        list_repair_rows,
    )
    from cageik_cli.run.cage import CageSettings, build_cage_file, repair_cage_file

    check_views([json_path], settings.inputs(), settings.overwrite, settings.outputs())
    with show_progress(not quiet, None, settings.overwrite) as progress:
        if isinstance(settings, CageSettings):
            if settings.animation and not (quiet or progress.is_drawn):
                click.echo("measuring cages on frames, which takes half a minute or more", err=True)
            built = build_cage_file(settings, progress)
            rows = list_cage_rows(built, is_detailed=get_verbosity() > 0)
            record, rest_options = format_cage_json(built), _name_rest(settings, built.rest_frame)
        else:
            repaired, diagonal = repair_cage_file(settings, progress)
            rows = list_repair_rows(repaired, diagonal)
            record, rest_options = format_repair_json(repaired, diagonal), ""
    if json_path is not None:
        write_or_print(record, json_path, settings.overwrite)
    if not quiet:
        command = f"cageik extract FRAMES --cage {settings.output}{rest_options}"
        click.echo(format_told(str(settings.output), rows, cage_command), err=True)
        click.echo(f"wrote {settings.output}; next: {command}", err=True)


def _name_rest(settings: "CageSettings", rest_frame: float | None) -> str:
    """Return the options by which `cageik extract` takes the same rest pose."""
    if settings.rest is not None:
        return f" --rest {settings.rest}"
    if rest_frame is None or settings.rest_frame is None:
        return ""
    return f" --rest-frame {format_frame_number(rest_frame)}"
