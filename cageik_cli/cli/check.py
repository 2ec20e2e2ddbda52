"""`cageik check`: is this cage fit to hold this model."""

from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.options.clip import clip_of, clip_options
from cageik_cli.cli.options.common import PATH, common, jobs, write_or_print


@click.command("check")
@click.argument("frames", nargs=-1)
@click.option("--cage", type=PATH, required=True, help="The cage to look at.")
@click.option("--rest", type=PATH, help="The rest pose.  [default: the first frame taken]")
@click.option("--rest-frame", type=int, help="Which of the frames taken is the rest pose, from 0.")
@click.option("--json", type=PATH, help="Write the record as JSON; - is stdout.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@clip_options
@jobs
@common
def check_command(json: Path | None, overwrite: bool, quiet: bool, **options: Any) -> None:
    """Look at everything of a cage, and of the rest pose of FRAMES in it, and say what is wrong.

    The verdict is fit, usable (it binds, but something will be poor) or unfit (exit code 1).
    Without FRAMES and --rest only the cage is looked at.
    """
    settings = _settings(options)

    from cageik_cli.formats.open import files_read
    from cageik_cli.util.outputs import keep_apart, prepare
    from cageik_cli.workflows.check import as_json, as_text, check

    keep_apart([json], [settings.cage, settings.rest, *files_read(list(settings.frames))])
    on_stdout = str(json) == "-"
    if json is not None and not on_stdout:
        prepare(json, overwrite)
    checked = check(settings)
    if json is not None:
        write_or_print(as_json(checked), json, overwrite)
    if not quiet:
        click.echo(as_text(checked), err=on_stdout)
    if checked.diagnosis.verdict == "unfit":
        raise click.exceptions.Exit(1)


def _settings(options: dict[str, Any]) -> Any:
    """The settings that the options mean; values that contradict are wrong usage."""
    from cageik_cli.workflows.check import CheckSettings

    if options["rest"] is not None and options["rest_frame"] is not None:
        raise click.UsageError("--rest and --rest-frame both name the rest pose; give one")
    if options["rest_frame"] is not None and not options["frames"]:
        raise click.UsageError("--rest-frame picks one of FRAMES; name them")
    options["rest_frame"] = options["rest_frame"] or 0
    return CheckSettings(clip=clip_of(options), **options)
