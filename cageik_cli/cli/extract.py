"""`cageik extract`: the cage of every frame."""

import json
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
    binding_options,
    choose_cache_folder,
    common_options,
    get_verbosity,
    is_on_command_line,
    jobs_option,
    memory_option,
    timings_option,
)
from cageik_cli.cli.options.limits import (
    echo_exceeded_limits,
    exit_with_code,
    limit_options,
    pop_limits,
)
from cageik_cli.util.errors import CageikError


@click.command("extract")
@click.argument("frames", nargs=-1, required=True)
@click.option("--cage", type=PATH_TYPE, help="The cage around the rest pose.")
@click.option(
    "--binding",
    type=PATH_TYPE,
    help="Take the weights, and the cage, from this file of cageik bind.",
)
@click.option(
    "-o", "--output", type=PATH_TYPE, default="cages.h5", show_default=True, help="The result file."
)
@click.option("--rest", type=PATH_TYPE, help="The rest pose.  [default: the first frame taken]")
@click.option("--rest-frame", type=int, help="Which of the frames taken is the rest pose, from 0.")
@binding_options
@click.option(
    "--alpha",
    type=float,
    default=1e-3,
    show_default=True,
    help="Weight of the cage's Laplacian: more is smoother and less exact.",
)
@click.option("--beta", type=float, default=1.0, show_default=True, help="Weight of the vertices.")
@click.option(
    "--align/--no-align",
    default=True,
    show_default=True,
    help="Move each frame rigidly onto the rest pose, solve there, move the cage back.",
)
@click.option(
    "--vertex-weights",
    type=PATH_TYPE,
    help="One number a vertex (text or .npy); 0 is missing data.",
)
@scene_options
@click.option(
    "--no-weights", is_flag=True, help="Leave the weights out of the result (a smaller file)."
)
@clip_options
@click.option(
    "--resume",
    is_flag=True,
    help="Go on where an interrupted run ended; begin if there was none.",
)
@click.option(
    "--on-bad-frame",
    type=click.Choice(["stop", "skip"]),
    default="stop",
    show_default=True,
    help="A frame that cannot be read: stop, or leave a gap and say so.",
)
@click.option(
    "--export",
    "exports",
    type=PATH_TYPE,
    multiple=True,
    help="Write the cages there too, as cageik export does; may be repeated.",
)
@limit_options
@click.option("--overwrite", is_flag=True, help="Replace existing outputs.")
@memory_option
@timings_option
@jobs_option
@common_options
def extract_command(**options: Any) -> None:
    """Extract the cage of every frame of an animation.

    FRAMES are meshes of one connectivity: files, folders and globs (.obj, .ply, .off, each also
    .gz), in natural order of their names, or one file that holds a clip (.h5, .npz, .npy, .mdd,
    .pc2, .anime, .usd*, .abc), of several FILE::CLIP.

    \b
    cageik extract frames --cage cage.obj --on-bad-frame skip
    cageik extract body.pc2 --rest body.obj --cage cage.obj --resume
    cageik extract shot.usdc::/hero/body --cage cage.obj --frames 0:48
    """  # noqa: D301
    timings: Path | None = options.pop("timings")
    quiet: bool = options.pop("quiet")
    exports: tuple[Path, ...] = options.pop("exports")
    baseline: Path | None = options["baseline"]
    limits = pop_limits(options)
    settings = make_extract_settings(options)

    from cageik_cli.cli.progress import show_progress
    from cageik_cli.formats.open import list_input_files
    from cageik_cli.formats.write import Output
    from cageik_cli.report.overview import build_clip_entry, build_overview
    from cageik_cli.report.record import build_report
    from cageik_cli.report.views.text import format_text
    from cageik_cli.util.outputs import check_no_overlap
    from cageik_cli.util.text import format_row
    from cageik_cli.workflows.export import ExportSettings, check_export, export
    from cageik_cli.workflows.extract import extract

    inputs = [settings.cage, settings.binding, settings.rest, settings.vertex_weights, baseline]
    export_settings = [
        ExportSettings(settings.output, Output(path, overwrite=settings.overwrite))
        for path in exports
    ]
    outputs = [settings.output, timings, *(one.output.target_path for one in export_settings)]
    check_no_overlap(outputs, inputs + list_input_files(list(settings.frames)))
    for one in export_settings:
        check_export(one)
    with show_progress(not quiet, timings, settings.overwrite) as progress:
        result = extract(settings, progress)
        summaries = [export(one, progress) for one in export_settings]
    report = build_report(result, limits)
    overview = build_overview([build_clip_entry(report)])
    if quiet:
        echo_exceeded_limits(overview)
    else:
        lines = [format_text(report), *map(format_row, progress.make_rows())]
        lines += [one.message for one in summaries]
        click.echo("\n".join(lines), err=True)
        click.echo(f"wrote {settings.output}; next: cageik report {settings.output}", err=True)
    if get_verbosity():
        click.echo(f"cache: {settings.cache}", err=True)
        click.echo(f"settings: {json.dumps(result.settings)}", err=True)
        click.echo(f"sources: {json.dumps(result.sources)}", err=True)
    exit_with_code(overview)


def make_extract_settings(options: dict[str, Any]) -> Any:
    """The settings that the options mean.

    Raises
    ------
    click.UsageError
        When values contradict each other.
    """
    from cageik_cli.coordinates.binding import BindSettings
    from cageik_cli.solver.dual_laplacian import SolveSettings
    from cageik_cli.workflows.plan import ExtractSettings

    if options["cage"] is None and options["binding"] is None:
        raise click.UsageError("Missing option '--cage', or '--binding', which holds one.")
    if options["rest"] is not None and options["rest_frame"] is not None:
        raise click.UsageError("--rest and --rest-frame both name the rest pose; give one")
    try:
        solve = SolveSettings(options.pop("alpha"), options.pop("beta"), options.pop("align"))
    except CageikError as error:
        raise click.UsageError(str(error)) from error
    bind = BindSettings(*(options.pop(name) for name in ("coordinates", "accuracy", "outside")))
    if options["binding"] is not None:
        _check_binding_settings(options["binding"], bind)
    options["cache"] = choose_cache_folder(options["cache"], options.pop("no_cache"))
    options["rest_frame"] = options["rest_frame"] or 0
    options["clip"], options["scene"] = pop_clip_settings(options), pop_scene_hints(options)
    options["keep_weights"] = not options.pop("no_weights")
    return ExtractSettings(solve=solve, bind=bind, **options)


def _check_binding_settings(binding: Path, requested: Any) -> None:
    """Refuse options that were typed and are not those the binding was made with."""
    from cageik_cli.store.binding_file import read_bind_settings

    names = [name for name in ("coordinates", "accuracy", "outside") if is_on_command_line(name)]
    if not names:
        return
    stored = read_bind_settings(binding)
    for name in names:
        if getattr(requested, name) != getattr(stored, name):
            raise click.UsageError(
                f"--{name} {getattr(requested, name)}: {binding} was made with "
                f"{getattr(stored, name)}; leave the option out, or bind again"
            )
