"""`cageik check`: whether a cage is fit to hold a model."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from cageik_cli.cli.options.clip import (
    CLIP_OPTIONS,
    choose_rest_frame,
    rest_frame_option,
    rest_option,
)
from cageik_cli.cli.options.common import (
    PATH_TYPE,
    common_options,
    jobs_option,
    overwrite_option,
    write_or_print,
)
from cageik_cli.cli.options.group import OptionGroup
from cageik_cli.formats.base.settings import ClipSettings, RestFrame

if TYPE_CHECKING:
    from cageik_cli.workflows.check import CheckSettings


def make_check_settings(
    cage: Path,
    frames: tuple[str, ...],
    rest: Path | None,
    rest_frame: RestFrame | None,
    clip: ClipSettings,
    jobs: int,
) -> "CheckSettings":
    """Make the settings of a check; values that contradict each other are wrong usage."""
    from cageik_cli.workflows.check import CheckSettings

    index = choose_rest_frame(rest, rest_frame)
    if rest_frame is not None and not frames:
        raise click.UsageError("--rest-frame needs FRAMES; name them, or leave it out")
    return CheckSettings(cage, frames, rest, index, jobs, clip)


@click.command("check")
@OptionGroup(
    "settings",
    make_check_settings,
    click.argument("frames", nargs=-1),
    click.option("--cage", type=PATH_TYPE, required=True, help="The cage to diagnose."),
    rest_option,
    rest_frame_option,
    CLIP_OPTIONS,
    jobs_option,
)
@click.option("--json", "json_path", type=PATH_TYPE, help="Write the record as JSON; - is stdout.")
@overwrite_option
@common_options
def check_command(
    settings: "CheckSettings", json_path: Path | None, overwrite: bool, quiet: bool
) -> None:
    """Diagnose a cage.

    The cage alone is checked, or the cage and the rest pose of FRAMES in it. Each finding has the
    numbers of its vertices or faces. The verdict is fit, usable (it binds, with warnings) or unfit
    (exit code 1).
    """
    from cageik_cli.util.outputs import check_no_overlap, check_writable
    from cageik_cli.workflows.check import check_cage, format_check_json, format_check_text

    check_no_overlap([json_path], settings.inputs())
    is_on_stdout = str(json_path) == "-"
    if json_path is not None and not is_on_stdout:
        check_writable(json_path, overwrite)
    result = check_cage(settings)
    if json_path is not None:
        write_or_print(format_check_json(result), json_path, overwrite)
    if not quiet:
        click.echo(format_check_text(result), err=is_on_stdout)
    if result.diagnosis.verdict == "unfit":
        raise click.exceptions.Exit(1)
