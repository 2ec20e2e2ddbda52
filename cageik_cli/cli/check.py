"""`cageik check`: is this cage fit to hold this model."""

from pathlib import Path

import click

from cageik_cli.cli.options import PATH, common, jobs, write_or_print


@click.command("check")
@click.argument("frames", nargs=-1)
@click.option("--cage", type=PATH, required=True, help="The cage to look at.")
@click.option("--rest", type=PATH, help="The rest pose.  [default: the first frame]")
@click.option("--rest-frame", type=int, help="The frame that is the rest pose, from 0.")
@click.option("--json", type=PATH, help="Write the record as JSON; - is stdout.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@jobs
@common
def check_command(
    frames: tuple[str, ...],
    cage: Path,
    rest: Path | None,
    rest_frame: int | None,
    json: Path | None,
    overwrite: bool,
    jobs: int,
    quiet: bool,
) -> None:
    """Look at everything of a cage, and of the rest pose of FRAMES in it, and say what is wrong.

    The verdict is fit, usable (it binds, but something will be poor) or unfit (exit code 1).
    Without FRAMES and --rest only the cage is looked at.
    """
    if rest is not None and rest_frame is not None:
        raise click.UsageError("--rest and --rest-frame both name the rest pose; give one")
    if rest_frame is not None and not frames:
        raise click.UsageError("--rest-frame picks one of FRAMES; name them")

    from cageik_cli.checking import CheckSettings, as_json, as_text, check
    from cageik_cli.outputs import keep_apart, prepare
    from cageik_cli.sequence import files_read

    keep_apart([json], [cage, rest, *files_read(list(frames))])
    on_stdout = str(json) == "-"
    if json is not None and not on_stdout:
        prepare(json, overwrite)
    checked = check(CheckSettings(cage, frames, rest, rest_frame or 0, jobs))
    if json is not None:
        write_or_print(as_json(checked), json, overwrite)
    if not quiet:
        click.echo(as_text(checked), err=on_stdout)
    if checked.diagnosis.verdict == "unfit":
        raise click.exceptions.Exit(1)
