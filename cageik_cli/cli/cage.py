"""`cageik cage`: a cage around a model."""

from dataclasses import fields
from pathlib import Path
from typing import Any

import click

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.cli.command import GroupedCommand, get_verbosity
from cageik_cli.cli.options import common_options, jobs_option, json_option
from cageik_cli.cli.options.group import (
    OptionGroup,
    is_on_command_line,
    list_options,
    refuse_options,
)
from cageik_cli.formats.timeline import format_frame_number
from cageik_cli.run.settings import CageSettings, RepairCageSettings


def make_cage_settings(cage: Path | None, **values: Any) -> CageSettings | RepairCageSettings:
    """Make the settings of a build or a repair; values that contradict are wrong usage."""
    model, rest = values["model"], values["rest"]
    if cage is None:
        if model is None:
            raise click.UsageError("Missing argument 'MODEL' (or '--repair', which names a cage).")
        return CageSettings(**values)
    build_names = (*(one.name for one in fields(BuildSettings)), "rest_frame", "animation")
    refuse_options(build_names, "--repair keeps the cage; leave out {}", is_on_command_line)
    if (model is None) == (rest is None):
        raise click.UsageError("--repair needs the model: give it with --rest, or as MODEL")
    return RepairCageSettings(
        cage,
        rest or Path(model),
        values["output"],
        given_in=values["given_in"],
        overwrite=values["overwrite"],
    )


@click.command("cage", cls=GroupedCommand)
@OptionGroup(
    "settings",
    make_cage_settings,
    *list_options(RepairCageSettings, {"cage": {}}),
    *list_options(CageSettings, jobs=jobs_option),
)
@json_option
@common_options
def cage_command(
    settings: CageSettings | RepairCageSettings, json_path: Path | None, quiet: bool
) -> None:
    """Build a cage around a model, or repair one.

    MODEL is a mesh, or a clip, of which the rest pose is taken. It may be open, have several parts
    or cross itself. The cage is closed, has one component, and encloses the whole surface.

    \b
    cageik cage body.obj -o cage.obj --vertices 150
    cageik cage body.obj -o cage.obj --for frames
    cageik cage --repair mine.obj --rest body.obj -o cage.obj
    """  # noqa: D301
    from cageik_cli.cli.output import (
        check_views,
        format_command_output,
        show_progress,
        write_or_print,
    )
    from cageik_cli.report.views.cage import (
        format_cage_json,
        format_repair_json,
        list_cage_rows,
        list_repair_rows,
    )
    from cageik_cli.run.cage import build_cage_file, repair_cage_file

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
        click.echo(format_command_output(str(settings.output), rows, cage_command), err=True)
        click.echo(f"wrote {settings.output}; next: {command}", err=True)


def _name_rest(settings: CageSettings, rest_frame: float | None) -> str:
    """Return the options by which `cageik extract` takes the same rest pose."""
    if settings.rest is not None:
        return f" --rest {settings.rest}"
    if rest_frame is None or settings.rest_frame is None:
        return ""
    return f" --rest-frame {format_frame_number(rest_frame)}"
