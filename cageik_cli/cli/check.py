"""`cageik check`: whether a cage is fit to hold a model."""

import shlex
from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.command import GroupedCommand, get_verbosity, option
from cageik_cli.cli.group import spell_option
from cageik_cli.cli.options import common_options, jobs_option, json_option, overwrite_option
from cageik_cli.cli.options.group import OptionGroup, list_options
from cageik_cli.cli.options.types import SuffixedPath
from cageik_cli.cli.output import check_views, format_command_output, list_files, write_or_print
from cageik_cli.run.settings import CheckSettings


def make_check_settings(**values: Any) -> CheckSettings:
    """Make the settings of a check; no cage is wrong usage."""
    if values["cage"] is None:
        frames = values["frames"]
        is_first = bool(frames) and Path(frames[0]).is_file()  # the cage is, more often than not
        words = shlex.join(frames[:3] if is_first else ("CAGE", *(frames[:2] or ("FRAMES",))))
        raise click.UsageError(f"Missing option '--cage': cageik check --cage {words}")
    return CheckSettings(**values)


@click.command("check", cls=GroupedCommand)
@OptionGroup(
    "settings",
    make_check_settings,
    *list_options(CheckSettings, jobs=jobs_option),
)
@json_option
@option(
    "--plot",
    type=SuffixedPath(".png"),
    help="Draw cage and rest pose with the faults numbered (.png).",
)
@option(
    "--marked",
    type=SuffixedPath(".ply"),
    help="Write cage and rest pose as one mesh with the faults as vertex colours (.ply).",
)
@overwrite_option
@common_options
def check_command(
    settings: CheckSettings,
    json_path: Path | None,
    plot: Path | None,
    marked: Path | None,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Diagnose a cage.

    The cage alone is checked, or the cage and the rest pose of FRAMES in it. Each finding has the
    numbers of its vertices or faces. The verdict is fit, usable (it binds, with warnings) or unfit
    (exit code 1). --plot and --marked show the faults that have a place, each in its colour. Its
    number in the picture is that in the list that is printed below the findings. The mesh of
    --marked is the cage followed by the rest pose.
    """
    from cageik_cli.report.views.cage import (
        format_check_headline,
        format_check_json,
        format_marks_text,
        list_brief_check_rows,
        list_check_rows,
    )
    from cageik_cli.run.check import check_cage

    is_on_stdout = str(json_path) == "-"
    views = [json_path, plot, marked]
    check_views(views, settings.inputs(), overwrite)
    result = check_cage(settings)
    if json_path is not None:
        write_or_print(format_check_json(result, spell_option), json_path, overwrite)
    if plot is not None:
        from cageik_cli.report.plots.model_plot import render_check_png  # slow: matplotlib

        picture = render_check_png(result.cage.mesh, result.rest_mesh, result.marks)
        write_or_print(picture, plot, overwrite)
    if marked is not None:
        from cageik_cli.report.views.cage import encode_marked_ply

        data = encode_marked_ply(result.cage.mesh, result.rest_mesh, result.marks)
        write_or_print(data, marked, overwrite)
    if not quiet:
        rows = (list_check_rows if get_verbosity() else list_brief_check_rows)(result)
        text = format_command_output(format_check_headline(result), rows, check_command)
        click.echo(text, err=is_on_stdout)
        if plot is not None or marked is not None:
            click.echo(format_marks_text(result), err=is_on_stdout)
        for path in list_files(views):
            click.echo(f"wrote {path}", err=is_on_stdout)
    if result.diagnosis.verdict == "unfit":
        raise click.exceptions.Exit(1)
