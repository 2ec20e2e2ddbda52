"""`cageik check`: is this cage fit to hold this model."""

from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.options.clip import clip_options, pop_clip_settings
from cageik_cli.cli.options.common import PATH_TYPE, common_options, jobs_option, write_or_print


@click.command("check")
@click.argument("frames", nargs=-1)
@click.option("--cage", type=PATH_TYPE, required=True, help="The cage to look at.")
@click.option("--rest", type=PATH_TYPE, help="The rest pose.  [default: the first frame taken]")
@click.option("--rest-frame", type=int, help="Which of the frames taken is the rest pose, from 0.")
@click.option("--json", type=PATH_TYPE, help="Write the record as JSON; - is stdout.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@clip_options
@jobs_option
@common_options
def check_command(json: Path | None, overwrite: bool, quiet: bool, **options: Any) -> None:
    """Look at everything of a cage, and of the rest pose of FRAMES in it, and say what is wrong.

    The verdict is fit, usable (it binds, but something will be poor) or unfit (exit code 1).
    Without FRAMES and --rest only the cage is looked at.
    """
    settings = _make_settings(options)

    from cageik_cli.formats.open import list_input_files
    from cageik_cli.util.outputs import check_no_overlap, check_writable
    from cageik_cli.workflows.check import check_cage, format_check_json, format_check_text

    check_no_overlap(
        [json], [settings.cage, settings.rest, *list_input_files(list(settings.frames))]
    )
    on_stdout = str(json) == "-"
    if json is not None and not on_stdout:
        check_writable(json, overwrite)
    result = check_cage(settings)
    if json is not None:
        write_or_print(format_check_json(result), json, overwrite)
    if not quiet:
        click.echo(format_check_text(result), err=on_stdout)
    if result.diagnosis.verdict == "unfit":
        raise click.exceptions.Exit(1)


def _make_settings(options: dict[str, Any]) -> Any:
    """The settings that the options mean; values that contradict are wrong usage."""
    from cageik_cli.workflows.check import CheckSettings

    if options["rest"] is not None and options["rest_frame"] is not None:
        raise click.UsageError("--rest and --rest-frame both name the rest pose; give one")
    if options["rest_frame"] is not None and not options["frames"]:
        raise click.UsageError("--rest-frame picks one of FRAMES; name them")
    options["rest_frame"] = options["rest_frame"] or 0
    return CheckSettings(clip=pop_clip_settings(options), **options)
