"""`cageik pose`: a model, or the animation of a result, moved by a few handles."""

from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.options.clip import UP_AXES
from cageik_cli.cli.options.common import (
    PATH_TYPE,
    binding_options,
    choose_cache_folder,
    common_options,
    is_on_command_line,
    jobs_option,
    memory_option,
    timings_option,
    write_or_print,
)
from cageik_cli.util.errors import CageikError

CAGE_OPTIONS = ("cage", "cage_out")
WEIGHT_OPTIONS = ("coordinates", "accuracy", "outside", "cache", "no_cache", "jobs")
RESULT_OPTIONS = ("memory",)


def _print_schema(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    if value:
        from cageik_cli.posing.handles.schema import read_schema

        click.echo(read_schema(), nl=False)
        ctx.exit()


@click.command("pose")
@click.argument("target", type=PATH_TYPE)
@click.argument("handles", type=PATH_TYPE)
@click.option(
    "-o",
    "--output",
    type=PATH_TYPE,
    required=True,
    help="The posed model (.obj, .ply); of a result, the edited result (.h5).",
)
@click.option("--cage", type=PATH_TYPE, help="The cage around TARGET, when that is a model.")
@click.option("--cage-out", type=PATH_TYPE, help="Write the posed cage there, too (.obj, .ply).")
@click.option(
    "--alpha",
    type=float,
    default=1e-6,
    show_default=True,
    help="Weight of the cage's Laplacian: more is smoother, and meets handles less.",
)
@click.option("--beta", type=float, default=1.0, show_default=True, help="Weight of the handles.")
@click.option("--hard", is_flag=True, help="Meet all handles exactly.")
@click.option(
    "--rigidity",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Rounds in which parts of the cage turn with the motion, where 0 shears them.",
)
@click.option("--snap", is_flag=True, help="Put handles with a position on the surface near it.")
@click.option(
    "--allow-conflicts",
    is_flag=True,
    help="Take the mean of different targets of one point.",
)
@click.option("--plot", type=PATH_TYPE, help="Draw it before and after, with the handles (.png).")
@click.option(
    "--up-axis",
    type=click.Choice(UP_AXES),
    help="Which axis is up in the picture.  [default: the result's, or Y]",
)
@click.option(
    "--json", "json_out", type=PATH_TYPE, help="Write the figures as JSON (- for stdout)."
)
@click.option(
    "--schema",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_schema,
    help="Print the JSON schema of the handles file, and end.",
)
@binding_options
@click.option("--overwrite", is_flag=True, help="Replace existing outputs.")
@memory_option
@timings_option
@jobs_option
@common_options
def pose_command(
    plot: Path | None,
    up_axis: str | None,
    json_out: Path | None,
    timings: Path | None,
    quiet: bool,
    **options: Any,
) -> None:
    """Move a model, or the animation of a result, by a few points of its surface.

    TARGET is a model with --cage, a binding of cageik bind, or a result, whose every frame keeps
    its own motion and gets the edit added. HANDLES is a JSON file that says which points go where.

    \b
    cageik pose rest.obj --cage cage.obj handles.json -o posed.obj
    cageik pose cages.h5 handles.json -o edited.h5 --plot edited.png
    """  # noqa: D301
    if plot is not None and str(plot) != "-" and plot.suffix.lower() != ".png":
        raise click.UsageError(f"--plot {plot}: expected a name that ends in .png")
    settings = _make_settings(options)

    from cageik_cli.cli.progress import show_progress
    from cageik_cli.report.views.pose_text import format_pose_json, format_pose_rows
    from cageik_cli.util.outputs import check_no_overlap, check_writable
    from cageik_cli.util.text import format_block
    from cageik_cli.workflows.edit import EditSettings, edit
    from cageik_cli.workflows.pose import pose

    inputs = [options["target"], options["handles"], options["cage"]]
    check_no_overlap([settings.output, options["cage_out"], plot, json_out, timings], inputs)
    for path in (plot, json_out):
        if path is not None and str(path) != "-":
            check_writable(path, settings.overwrite)
    is_edit = isinstance(settings, EditSettings)
    with show_progress(not quiet, timings, settings.overwrite) as progress:
        result = edit(settings, progress) if is_edit else pose(settings, progress)
        if plot is not None:
            with progress.stage("plot"):
                write_or_print(_render_plot(result.snapshot, up_axis), plot, settings.overwrite)
    if json_out is not None:
        write_or_print(format_pose_json(result.summary), json_out, settings.overwrite)
    if not quiet:
        rows = [*format_pose_rows(result.summary), *progress.make_rows()]
        click.echo(format_block(str(settings.output), rows), err=True)
        next_step = f"; next: cageik report {settings.output}" if is_edit else ""
        written = [settings.output, options["cage_out"], plot, json_out]
        names = [str(path) for path in written if path is not None and str(path) != "-"]
        click.echo(f"wrote {', '.join(names)}{next_step}", err=True)


def _render_plot(snapshot: Any, up_axis: str | None) -> bytes:
    """Before and after, as a PNG file; matplotlib takes long to import."""
    from dataclasses import replace

    from cageik_cli.report.plots.pose_plot import render_pose_png

    return render_pose_png(replace(snapshot, up_axis=up_axis or snapshot.up_axis))


def _make_settings(options: dict[str, Any]) -> Any:
    """What is to be done, as an edit of a result or a pose of a model.

    Raises
    ------
    click.UsageError
        When options contradict each other or TARGET.
    """
    from cageik_cli.coordinates.binding import BindSettings
    from cageik_cli.formats.base.hdf5 import HDF5_SUFFIXES
    from cageik_cli.posing.edits import PosingSettings
    from cageik_cli.posing.handles.model import PlacementSettings
    from cageik_cli.store.binding_file import is_binding
    from cageik_cli.workflows.bind import WeightSettings
    from cageik_cli.workflows.edit import EditSettings
    from cageik_cli.workflows.pose import PoseSettings

    place = PlacementSettings(options["snap"], options["allow_conflicts"], options["hard"])
    try:
        posing = PosingSettings(options["alpha"], options["beta"], options["rigidity"], place)
    except CageikError as error:
        raise click.UsageError(str(error)) from error
    target, handles = options["target"], options["handles"]
    if target.suffix.lower() == ".json" and handles.suffix.lower() != ".json":
        raise click.UsageError(f"TARGET comes before HANDLES; swap {target} and {handles}")
    files = (target, handles, options["output"])
    overwrite = options["overwrite"]
    is_hdf5 = target.suffix.lower() in HDF5_SUFFIXES
    if is_hdf5 and not is_binding(target):
        _reject_options(
            (*CAGE_OPTIONS, *WEIGHT_OPTIONS), "a model; a result has its cage and weights"
        )
        return EditSettings(*files, posing, options["memory"], overwrite)
    _reject_options(RESULT_OPTIONS, "a result, whose frames are gone through in blocks")
    if is_hdf5:
        _reject_options(("cage", *WEIGHT_OPTIONS), "a model; a binding has its cage and weights")
    elif options["cage"] is None:
        raise click.UsageError(f"Missing option '--cage', which {target} needs.")
    bind = BindSettings(*(options[name] for name in ("coordinates", "accuracy", "outside")))
    cache = choose_cache_folder(options["cache"], options["no_cache"])
    weights = WeightSettings(bind, cache, options["jobs"])
    return PoseSettings(*files, options["cage"], options["cage_out"], posing, weights, overwrite)


def _reject_options(names: tuple[str, ...], purpose: str) -> None:
    """Refuse options that say nothing of this kind of TARGET."""
    for name in names:
        if is_on_command_line(name):
            raise click.UsageError(f"--{name.replace('_', '-')} is for {purpose}; leave it out")
