"""`cageik check`: whether a cage is fit to hold a model."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cageik_cli.cli.options import (
    PATH_TYPE,
    OptionGroup,
    common_options,
    is_given,
    jobs_option,
    overwrite_option,
)
from cageik_cli.cli.options.clip import CLIP_OPTIONS, rest_frame_option, rest_option
from cageik_cli.cli.output import write_or_print

if TYPE_CHECKING:
    from cageik_cli.report.views.cage_check import CheckResult
    from cageik_cli.workflows.check import CheckSettings


def make_check_settings(**values: Any) -> "CheckSettings":
    """Make the settings of a check; a rest frame of no clip is wrong usage."""
    from cageik_cli.workflows.check import CheckSettings

    if is_given("rest_frame") and not values["frames"]:
        raise click.UsageError("--rest-frame needs FRAMES; name them, or leave it out")
    return CheckSettings(**values)


@dataclass(frozen=True, slots=True)
class CheckViews:
    """The files that a check writes; each may be absent.

    Raises
    ------
    click.UsageError
        When one has another suffix.
    """

    json_path: Path | None
    plot: Path | None
    marked: Path | None

    def __post_init__(self) -> None:
        for name, path, suffix in (("plot", self.plot, ".png"), ("marked", self.marked, ".ply")):
            if path is not None and path.suffix.lower() != suffix:
                raise click.UsageError(f"--{name} {path}: expected a name that ends in {suffix}")


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
@OptionGroup(
    "views",
    CheckViews,
    click.option(
        "--json", "json_path", type=PATH_TYPE, help="Write the record as JSON; - is stdout."
    ),
    click.option(
        "--plot", type=PATH_TYPE, help="Draw cage and rest pose with the faults numbered (.png)."
    ),
    click.option(
        "--marked",
        type=PATH_TYPE,
        help="Write cage and rest pose as one mesh with the faults as vertex colours (.ply).",
    ),
)
@overwrite_option
@common_options
def check_command(
    settings: "CheckSettings", views: CheckViews, overwrite: bool, quiet: bool
) -> None:
    """Diagnose a cage.

    The cage alone is checked, or the cage and the rest pose of FRAMES in it. Each finding has the
    numbers of its vertices or faces. The verdict is fit, usable (it binds, with warnings) or unfit
    (exit code 1). --plot and --marked show the faults that have a place, each in its colour. Its
    number in the picture is that in the list that is printed below the findings. The mesh of
    --marked is the cage followed by the rest pose.
    """
    from cageik_cli.report.views.cage_check import (
        format_check_json,
        format_check_text,
        format_marks_text,
    )
    from cageik_cli.util.outputs import check_no_overlap, check_writable
    from cageik_cli.workflows.check import check_cage

    json_path = views.json_path
    is_on_stdout = str(json_path) == "-"
    outputs = [json_path, views.plot, views.marked]
    check_no_overlap(outputs, settings.inputs())
    for path in outputs:
        if path is not None and str(path) != "-":
            check_writable(path, overwrite)
    result = check_cage(settings)
    if json_path is not None:
        write_or_print(format_check_json(result), json_path, overwrite)
    _write_pictures(result, views, overwrite)
    if not quiet:
        click.echo(format_check_text(result), err=is_on_stdout)
        if views.plot is not None or views.marked is not None:
            click.echo(format_marks_text(result), err=is_on_stdout)
        for path in outputs:
            if path is not None and str(path) != "-":
                click.echo(f"wrote {path}", err=is_on_stdout)
    if result.diagnosis.verdict == "unfit":
        raise click.exceptions.Exit(1)


def _write_pictures(result: "CheckResult", views: CheckViews, overwrite: bool) -> None:
    """Write the picture and the coloured mesh; what draws them is slow to import."""
    from cageik_cli.util.outputs import write_bytes

    cage, rest, marks = result.cage.mesh, result.rest_mesh, result.marks
    if views.plot is not None:
        from cageik_cli.report.plots.cage_plot import render_check_png

        write_bytes(views.plot, render_check_png(cage, rest, marks), overwrite)
    if views.marked is not None:
        from cageik_cli.report.check_marks import encode_marked_ply

        write_bytes(views.marked, encode_marked_ply(cage, rest, marks), overwrite)
