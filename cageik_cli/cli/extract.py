"""`cageik extract`: the cage of every frame."""

import json
from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.options import PATH, Size, common, jobs, verbosity
from cageik_cli.errors import CageikError


@click.command("extract")
@click.argument("frames", nargs=-1, required=True)
@click.option("--cage", type=PATH, required=True, help="The cage around the rest pose.")
@click.option(
    "-o", "--output", type=PATH, default="cages.h5", show_default=True, help="The result file."
)
@click.option("--rest", type=PATH, help="The rest pose.  [default: the first frame]")
@click.option("--rest-frame", type=int, help="The frame that is the rest pose, from 0.")
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
    "--vertex-weights", type=PATH, help="One number a vertex (text or .npy); 0 is missing data."
)
@click.option(
    "--fps",
    type=float,
    default=24.0,
    show_default=True,
    help="Frames a second; recorded, nothing depends on it.",
)
@click.option(
    "--no-weights", is_flag=True, help="Leave the weights out of the result (a smaller file)."
)
@click.option("--allow-gaps", is_flag=True, help="Take frames although a number is missing.")
@click.option("--overwrite", is_flag=True, help="Replace an existing result.")
@click.option(
    "--memory",
    type=Size(),
    default="1GiB",
    show_default=True,
    help="Most for blocks of frames.",
)
@click.option("--timings", type=PATH, help="Write the seconds of each stage to this JSON file.")
@jobs
@common
def extract_command(**options: Any) -> None:
    """Extract the cage of every frame of an animation.

    FRAMES are meshes of one connectivity: files, folders and globs, in natural order of their
    names, or one file that holds a clip (.h5, .npz).
    """
    timings: Path | None = options.pop("timings")
    quiet: bool = options.pop("quiet")
    settings = _settings(options)

    from cageik_cli.cli.watching import Watch
    from cageik_cli.extraction import extract
    from cageik_cli.layout import row
    from cageik_cli.outputs import keep_apart, prepare, write_text
    from cageik_cli.report import as_text, report_of
    from cageik_cli.sequence import files_read

    inputs = [settings.cage, settings.rest, settings.vertex_weights]
    keep_apart([settings.output, timings], inputs + files_read(list(settings.frames)))
    if timings is not None:
        prepare(timings, settings.overwrite)
    watch = Watch(draw=not quiet)
    try:
        result = extract(settings, watch)
    finally:
        seconds = watch.close()
    if timings is not None:
        write_text(timings, json.dumps(seconds, indent=1) + "\n", settings.overwrite)
    if not quiet:
        click.echo(as_text(report_of(result)), err=True)
        stages = ", ".join(f"{name} {value:.2f}" for name, value in seconds.items())
        click.echo(row(("seconds", stages)), err=True)
        click.echo(f"wrote {settings.output}; next: cageik report {settings.output}", err=True)
    if verbosity():
        click.echo(f"settings: {json.dumps(result.settings)}", err=True)
        click.echo(f"sources: {json.dumps(result.sources)}", err=True)


def _settings(options: dict[str, Any]) -> Any:
    """The settings that the options mean; values that contradict are wrong usage."""
    from cageik_cli.dual_laplacian import SolveSettings
    from cageik_cli.extraction import ExtractSettings

    if options["rest"] is not None and options["rest_frame"] is not None:
        raise click.UsageError("--rest and --rest-frame both name the rest pose; give one")
    if not 0 < options["fps"] < float("inf"):
        raise click.UsageError(f"--fps is {options['fps']}, expected a number above zero")
    try:
        solve = SolveSettings(options.pop("alpha"), options.pop("beta"), options.pop("align"))
    except CageikError as error:
        raise click.UsageError(str(error)) from error
    options["rest_frame"] = options["rest_frame"] or 0
    options["keep_weights"] = not options.pop("no_weights")
    return ExtractSettings(solve=solve, **options)
