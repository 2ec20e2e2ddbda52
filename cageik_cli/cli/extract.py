"""`cageik extract`: the cage of every frame."""

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cageik_cli.cli.command import GroupedCommand, get_verbosity, option
from cageik_cli.cli.group import spell_option
from cageik_cli.cli.options import CACHE_OPTIONS, common_options, jobs_option, timings_option
from cageik_cli.cli.options.group import (
    PATH_TYPE,
    OptionGroup,
    is_on_command_line,
    list_options,
    refuse_options,
)
from cageik_cli.cli.options.limits import LIMIT_OPTIONS, LimitOptions
from cageik_cli.cli.options.solve import choose_fit_settings
from cageik_cli.fit.settings import FitSettings
from cageik_cli.inputs.settings import BUILD_OPTIONS
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.run.settings import ExportSettings, ExtractSettings
from cageik_cli.util.settings import HelpGroup

if TYPE_CHECKING:
    from cageik_cli.cli.output import ProgressBar
    from cageik_cli.report.record import Report
    from cageik_cli.store.result import Result
    from cageik_cli.util.progress import ProgressListener


def make_extract_settings(**values: Any) -> ExtractSettings:
    """Make the settings of a run; values that contradict each other are wrong usage."""
    _refuse_swap(values["frames"], values["cage"])
    if values["binding"] is not None:
        _check_binding_settings(values["binding"], values["bind"])
    if values["cage"] is not None or values["binding"] is not None:
        given = "--binding" if values["cage"] is None else "--cage"
        message = "{} is for a cage that is built; leave out {} or " + given
        refuse_options((*BUILD_OPTIONS, "cage_output"), message)
    return ExtractSettings(**values)


def _refuse_swap(frames: tuple[str, ...], cage: Path | None) -> None:
    """Refuse a folder as the cage of one mesh: say what to type, with both swapped."""
    from cageik_cli.formats.find_files import mesh_suffixes

    if cage is None or not cage.is_dir() or len(frames) != 1:
        return
    if Path(frames[0]).is_file() and Path(frames[0]).suffix.lower() in mesh_suffixes():
        words = shlex.join([str(cage), "--cage", frames[0]])
        raise click.UsageError(
            f"--cage {cage}: is a folder, expected the file of a cage; if both are swapped, type: "
            f"cageik extract {words}"
        )


def _check_binding_settings(binding: Path, requested: BindSettings) -> None:
    """Refuse options on the command line that differ from those of the binding."""
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


EXTRACT_OPTIONS = OptionGroup(
    "settings",
    make_extract_settings,
    *list_options(
        ExtractSettings,
        cache=CACHE_OPTIONS,
        fit=OptionGroup(
            "fit",
            choose_fit_settings,
            option(
                "--fit/--no-fit",
                "is_fitted",
                default=None,
                help="Fit the weights to the clip.  [default: if a cage is built]",
                group=HelpGroup.FIRST,
            ),
            *list_options(FitSettings),
        ),
        jobs=jobs_option,
    ),
)


@click.command("extract", cls=GroupedCommand)
@EXTRACT_OPTIONS
@option(
    "--export",
    "exports",
    type=PATH_TYPE,
    multiple=True,
    is_per_clip=False,
    help="Also write the cages to this file, as cageik export does; may be repeated.",
    group=HelpGroup.WRITTEN,
)
@LIMIT_OPTIONS
@timings_option
@common_options
def extract_command(
    settings: ExtractSettings,
    exports: tuple[Path, ...],
    limits: LimitOptions,
    timings: Path | None,
    quiet: bool,
) -> None:
    """Extract the cage of every frame.

    FRAMES are meshes of one connectivity: files, folders and globs (.obj, .ply, .off, .stl, each
    also .gz), in natural order of their names, or one file that contains a clip (.h5, .npz, .npy,
    .mdd, .pc2, .anime, .usd*, .abc, .glb, .gltf). FILE::CLIP names one of several clips in a file.

    \b
    cageik extract frames --cage-vertices 150
    cageik extract body.pc2 --rest body.obj --cage cage.obj --resume
    cageik extract shot.usdc::/hero/body --cage cage.obj --frames 1020-1060
    cageik extract hero.glb::Run --fit --fps 30
    """  # noqa: D301
    from cageik_cli.cli.output import (
        echo_exceeded_limits,
        echo_gaps,
        exit_with_code,
        show_progress,
    )
    from cageik_cli.report.overview import Overview, build_clip_entry
    from cageik_cli.report.record import build_report
    from cageik_cli.run.extraction import extract
    from cageik_cli.util.outputs import check_no_overlap

    loaded_limits = limits.load()
    planned = _plan_exports(settings, exports)
    exported = [path for one in planned for path in one.outputs()]
    check_no_overlap(
        [*settings.outputs(), timings, *exported], [*settings.inputs(), limits.baseline]
    )
    with show_progress(not quiet, timings, settings.overwrite, resume=settings.resume) as progress:
        result = extract(settings, progress)
        messages = _export(planned, progress)
    report = build_report(result, loaded_limits, spelling=spell_option)
    overview = Overview([build_clip_entry(report)], limits={report.result: loaded_limits})
    if quiet:
        echo_exceeded_limits(overview)
    else:
        click.echo(_format_run(report, progress), err=True)
        for text in [*messages, *_list_written(settings, result)]:
            click.echo(text, err=True)
        echo_gaps(overview)
    if get_verbosity():
        click.echo(f"cache: {settings.cache}", err=True)
        click.echo(f"settings: {json.dumps(result.settings)}", err=True)
        click.echo(f"sources: {json.dumps(result.sources)}", err=True)
    exit_with_code(overview)


def _format_run(report: "Report", progress: "ProgressBar") -> str:
    """Return what is read of a run; with -v all figures, notes and seconds."""
    from cageik_cli.report.views.front import format_front
    from cageik_cli.report.views.text import format_text
    from cageik_cli.util.text import format_row

    if not get_verbosity():
        noted_labels = {"resumed", "unchanged"}
        notes = [
            ("note", f"{label} {text}") if label in noted_labels else (label, text)
            for label, text in progress.notes
        ]
        return format_front(report, notes, progress.seconds["total"], source="-v")
    text = format_text(report, is_verbose=True, spelling=spell_option)
    return "\n".join([text, *map(format_row, progress.make_rows())])


def _list_written(settings: ExtractSettings, result: "Result") -> list[str]:
    """Return lines on the files that were written, and what to do with the result."""
    from cageik_cli.cli.output import list_next_steps

    cage = [] if settings.cage_output is None else [f"wrote {settings.cage_output}"]
    return [*cage, f"wrote {settings.output}", *list_next_steps(result)]


def _export(planned: list[ExportSettings], progress: "ProgressListener") -> list[str]:
    """Write the exports, and return a description of each."""
    if not planned:
        return []
    from cageik_cli.run.export import export

    return [export(one, progress).message for one in planned]


def _plan_exports(settings: ExtractSettings, paths: tuple[Path, ...]) -> list[ExportSettings]:
    """Make the settings of the exports, and check them before any work."""
    if not paths:
        return []
    from cageik_cli.formats.write import Output
    from cageik_cli.run.export import check_export

    outputs = [Output(path, overwrite=settings.overwrite) for path in paths]
    planned = [ExportSettings((settings.output,), output) for output in outputs]
    for one in planned:
        check_export(one)
    return planned
