"""`cageik pose`: a model, or the animation of a result, moved by a few handles."""

from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.options.clip import UP_AXES
from cageik_cli.cli.options.common import (
    PATH,
    binding_options,
    cache_folder,
    common,
    is_typed,
    jobs,
    memory_option,
    timings_option,
    write_or_print,
)
from cageik_cli.util.errors import CageikError

OF_A_CAGE = ("cage", "cage_out")
OF_WEIGHTS = ("coordinates", "accuracy", "outside", "cache", "no_cache", "jobs")
OF_A_RESULT = ("memory",)


def _print_schema(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    if value:
        from cageik_cli.posing.handles.schema import schema_text

        click.echo(schema_text(), nl=False)
        ctx.exit()


@click.command("pose")
@click.argument("target", type=PATH)
@click.argument("handles", type=PATH)
@click.option(
    "-o",
    "--output",
    type=PATH,
    required=True,
    help="The posed model (.obj, .ply); of a result, the edited result (.h5).",
)
@click.option("--cage", type=PATH, help="The cage around TARGET, when that is a model.")
@click.option("--cage-out", type=PATH, help="Write the posed cage there, too (.obj, .ply).")
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
@click.option("--plot", type=PATH, help="Draw it before and after, with the handles (.png).")
@click.option(
    "--up-axis",
    type=click.Choice(UP_AXES),
    help="Which axis is up in the picture.  [default: the result's, or Y]",
)
@click.option("--json", "json_out", type=PATH, help="Write the figures as JSON (- for stdout).")
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
@jobs
@common
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
    settings = _settings(options)

    from cageik_cli.cli.progress import watched
    from cageik_cli.report.views.pose_text import pose_json, pose_rows
    from cageik_cli.util.outputs import keep_apart, prepare
    from cageik_cli.util.text import page
    from cageik_cli.workflows.edit import EditSettings, edit
    from cageik_cli.workflows.pose import pose

    inputs = [options["target"], options["handles"], options["cage"]]
    keep_apart([settings.output, options["cage_out"], plot, json_out, timings], inputs)
    for path in (plot, json_out):
        if path is not None and str(path) != "-":
            prepare(path, settings.overwrite)
    is_edit = isinstance(settings, EditSettings)
    with watched(not quiet, timings, settings.overwrite) as watch:
        posed = edit(settings, watch) if is_edit else pose(settings, watch)
        if plot is not None:
            with watch.stage("plot"):
                write_or_print(_picture(posed, up_axis), plot, settings.overwrite)
    if json_out is not None:
        write_or_print(pose_json(posed.figures), json_out, settings.overwrite)
    if not quiet:
        rows = [*pose_rows(posed.figures), *watch.rows()]
        click.echo(page(str(settings.output), rows), err=True)
        following = f"; next: cageik report {settings.output}" if is_edit else ""
        written = [settings.output, options["cage_out"], plot, json_out]
        names = [str(path) for path in written if path is not None and str(path) != "-"]
        click.echo(f"wrote {', '.join(names)}{following}", err=True)


def _picture(posed: Any, up_axis: str | None) -> bytes:
    """Before and after, as a PNG file; matplotlib takes long to import."""
    from cageik_cli.report.plots.pose_plot import as_png, view_of

    return as_png(view_of(posed, up_axis or posed.up_axis))


def _settings(options: dict[str, Any]) -> Any:
    """What is to be done, as an edit of a result or a pose of a model.

    Raises
    ------
    click.UsageError
        When options contradict each other or TARGET.
    """
    from cageik_cli.coordinates.binding import BindSettings
    from cageik_cli.formats.base.hdf5 import SUFFIXES
    from cageik_cli.posing.edits import PosingSettings
    from cageik_cli.posing.handles.model import PlaceSettings
    from cageik_cli.store.binding_file import is_binding
    from cageik_cli.workflows.bind import WeightSettings
    from cageik_cli.workflows.edit import EditSettings
    from cageik_cli.workflows.pose import PoseSettings

    place = PlaceSettings(options["snap"], options["allow_conflicts"], options["hard"])
    try:
        posing = PosingSettings(options["alpha"], options["beta"], options["rigidity"], place)
    except CageikError as error:
        raise click.UsageError(str(error)) from error
    target, handles = options["target"], options["handles"]
    if target.suffix.lower() == ".json" and handles.suffix.lower() != ".json":
        raise click.UsageError(f"TARGET comes before HANDLES; swap {target} and {handles}")
    files = (target, handles, options["output"])
    overwrite = options["overwrite"]
    is_hdf5 = target.suffix.lower() in SUFFIXES
    if is_hdf5 and not is_binding(target):
        _refuse_typed((*OF_A_CAGE, *OF_WEIGHTS), "a model; a result has its cage and weights")
        return EditSettings(*files, posing, options["memory"], overwrite)
    _refuse_typed(OF_A_RESULT, "a result, whose frames are gone through in blocks")
    if is_hdf5:
        _refuse_typed(("cage", *OF_WEIGHTS), "a model; a binding has its cage and weights")
    elif options["cage"] is None:
        raise click.UsageError(f"Missing option '--cage', which {target} needs.")
    bind = BindSettings(*(options[name] for name in ("coordinates", "accuracy", "outside")))
    cache = cache_folder(options["cache"], options["no_cache"])
    weights = WeightSettings(bind, cache, options["jobs"])
    return PoseSettings(*files, options["cage"], options["cage_out"], posing, weights, overwrite)


def _refuse_typed(names: tuple[str, ...], whose: str) -> None:
    """Refuse options that say nothing of this kind of TARGET."""
    for name in names:
        if is_typed(name):
            raise click.UsageError(f"--{name.replace('_', '-')} is for {whose}; leave it out")
