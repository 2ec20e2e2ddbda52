"""`cageik pose`: a model, or the animation of a result, moved by a few handles."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.command import GroupedCommand, get_verbosity, option
from cageik_cli.cli.options import (
    CACHE_OPTIONS,
    WEIGHT_NAMES,
    common_options,
    jobs_option,
    timings_option,
)
from cageik_cli.cli.options.group import (
    PATH_TYPE,
    OptionGroup,
    is_on_command_line,
    list_options,
    refuse_options,
)
from cageik_cli.cli.options.types import SuffixedPath
from cageik_cli.cli.output import check_views, list_files, write_or_print
from cageik_cli.formats.settings import UP_AXES
from cageik_cli.run.settings import EditSettings, PoseSettings


def make_pose_settings(
    target: Path, cage: Path | None, cage_output: Path | None, **others: Any
) -> PoseSettings | EditSettings:
    """Make the settings of an edit of a result, or of a pose of a model."""
    from cageik_cli.formats.base.hdf5 import HDF5_SUFFIXES
    from cageik_cli.inputs.source import holds_caged_model
    from cageik_cli.store.binding_file import is_binding

    handles = others["handles"]
    if handles is None and others["cage_edits"] is None:
        raise click.UsageError("Missing argument 'HANDLES', or option '--cage-edits'.")
    if handles and target.suffix.lower() == ".json" and handles.suffix.lower() != ".json":
        raise click.UsageError(f"TARGET comes before HANDLES; swap {target} and {handles}")
    weight_names = WEIGHT_NAMES
    is_hdf5 = target.suffix.lower() in HDF5_SUFFIXES
    is_clip = is_hdf5 and cage is not None and not holds_caged_model(target)
    is_hdf5 = is_hdf5 and not is_clip
    if is_hdf5 and not is_binding(target):
        refuse_options(
            ("cage", "given_in", "exclude", "cage_output", *weight_names),
            "{} is for a model; a result has its cage and weights; leave it out",
            is_on_command_line,
        )
        del others["weights"], others["given_in"], others["exclude"]
        return EditSettings(target, **others)
    if is_hdf5:
        refuse_options(
            ("cage", "given_in", "exclude", *weight_names),
            "{} is for a model; a binding has its cage and weights; leave it out",
            is_on_command_line,
        )
    elif cage is None:
        raise click.UsageError(f"Missing option '--cage', which {target} needs.")
    return PoseSettings(target, cage=cage, cage_output=cage_output, **others)


def _print_schema(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    if value:
        from cageik_cli.editing.handles.reader import read_schema

        is_of_cage = param.name == "cage_edits_schema"
        click.echo(read_schema("cage_edits" if is_of_cage else "handles"), nl=False)
        ctx.exit()


@click.command("pose", cls=GroupedCommand)
@OptionGroup(
    "settings",
    make_pose_settings,
    *list_options(PoseSettings, cache=CACHE_OPTIONS, jobs=jobs_option),
)
@option(
    "--plot",
    type=SuffixedPath(".png", allow_dash=True),
    help="Draw the model before and after, with the handles (.png).",
)
@option(
    "--up-axis",
    type=click.Choice(UP_AXES),
    help="Axis that points up in the picture.  [default: that of the result, or Y]",
)
@option("--json", "json_path", type=PATH_TYPE, help="Write the figures as JSON; - is stdout.")
@option(
    "--schema",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_schema,
    help="Print the JSON schema of the handles file and exit.",
)
@option(
    "--cage-edits-schema",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_schema,
    help="Print the JSON schema of the cage edits file and exit.",
)
@timings_option
@common_options
def pose_command(
    settings: PoseSettings | EditSettings,
    plot: Path | None,
    up_axis: str | None,
    json_path: Path | None,
    timings: Path | None,
    quiet: bool,
) -> None:
    """Move a model or clip by points or its cage.

    TARGET is a model with --cage, a binding of cageik bind, or a result. Each frame of a result
    keeps its own motion and the edit is added. HANDLES is a JSON file that says which points move
    where; with --cage-edits, cage vertices move, and HANDLES may be left out.

    \b
    cageik pose rest.obj --cage cage.obj handles.json -o posed.obj
    cageik pose cages.h5 handles.json -o edited.h5 --plot edited.png
    """  # noqa: D301
    from cageik_cli.cli.output import format_command_output, list_next_steps, show_progress
    from cageik_cli.report.views.pose_text import (
        format_pose_json,
        format_pose_rows,
        list_brief_pose_rows,
    )
    from cageik_cli.run.edit import edit, pose
    from cageik_cli.store.result import read_animation

    check_views(
        [plot, json_path], settings.inputs(), settings.overwrite, [*settings.outputs(), timings]
    )
    with show_progress(not quiet, timings, settings.overwrite) as progress:
        if isinstance(settings, EditSettings):
            result = edit(settings, progress)
        else:
            result = pose(settings, progress)
        if plot is not None:
            with progress.stage("plot"):
                from cageik_cli.report.plots.model_plot import render_pose_png  # slow: matplotlib

                chosen_axis = up_axis or result.snapshot.up_axis
                picture = render_pose_png(replace(result.snapshot, up_axis=chosen_axis))
                write_or_print(picture, plot, settings.overwrite)
    if json_path is not None:
        write_or_print(format_pose_json(result.summary), json_path, settings.overwrite)
    if not quiet:
        list_rows = format_pose_rows if get_verbosity() else list_brief_pose_rows
        rows = [*list_rows(result.summary), *progress.make_rows()]
        written = list_files([*settings.outputs(), plot, json_path])
        is_edit = isinstance(settings, EditSettings)
        steps = list_next_steps(read_animation(settings.output)) if is_edit else []
        after = [f"wrote {', '.join(written)}", *steps]
        text = format_command_output(str(settings.output), rows, pose_command, len(after))
        click.echo("\n".join([text, *after]), err=True)
