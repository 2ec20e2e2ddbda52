"""`cageik extract`: the cage of every frame."""

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.cli.options.capture import CAPTURE_OPTIONS
from cageik_cli.cli.options.clip import (
    CLIP_OPTIONS,
    SCENE_OPTIONS,
    choose_rest_frame,
    rest_frame_option,
    rest_option,
)
from cageik_cli.cli.options.common import (
    BIND_OPTIONS,
    CACHE_OPTIONS,
    PATH_TYPE,
    common_options,
    get_verbosity,
    is_given,
    is_on_command_line,
    jobs_option,
    memory_option,
    overwrite_option,
    timings_option,
    usage_errors,
)
from cageik_cli.cli.options.fit import FIT_NAMES, FIT_STRENGTH_OPTIONS, make_fit_settings
from cageik_cli.cli.options.group import OptionGroup
from cageik_cli.cli.options.limits import (
    LIMIT_OPTIONS,
    LimitOptions,
    echo_exceeded_limits,
    exit_with_code,
)
from cageik_cli.cli.options.solve import SOLVE_OPTIONS, vertex_weights_option
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.formats.settings import ClipSettings, RestFrame, SceneHints
from cageik_cli.solver.fitting.record import FitSettings
from cageik_cli.solver.settings import CaptureSettings, SolveSettings

if TYPE_CHECKING:
    from cageik_cli.formats.write import ExportSummary
    from cageik_cli.store.result import Result
    from cageik_cli.util.progress import ProgressListener
    from cageik_cli.workflows.export import ExportSettings
    from cageik_cli.workflows.settings import ExtractSettings


FIT_OPTIONS = OptionGroup(
    "fit",
    make_fit_settings,
    click.option("--fit", "is_fitted", is_flag=True, help="Fit the weights to the clip."),
    *FIT_STRENGTH_OPTIONS,
    names=("is_fitted", *FIT_NAMES),
)


def make_extract_settings(
    frames: tuple[str, ...],
    cage: Path | None,
    binding: Path | None,
    output: Path,
    rest: Path | None,
    rest_frame: RestFrame | None,
    bind: BindSettings,
    cache: Path | None,
    solve: SolveSettings,
    vertex_weights: Path | str | None,
    scene: SceneHints,
    no_weights: bool,
    clip: ClipSettings,
    resume: bool,
    on_bad_frame: str,
    overwrite: bool,
    memory: int,
    jobs: int,
    cage_vertices: int,
    cage_output: Path | None,
    fit: FitSettings | None,
    capture: CaptureSettings,
    missing: bool,
) -> "ExtractSettings":
    """Make the settings of a run; values that contradict each other are wrong usage."""
    from cageik_cli.workflows.settings import ExtractSettings

    if binding is not None:
        _check_binding_settings(binding, bind)
    with usage_errors():
        build = BuildSettings(cage_vertices)
    if cage is not None or binding is not None:
        _check_no_cage_is_built("--binding" if cage is None else "--cage")
    with usage_errors():
        return ExtractSettings(
            frames=frames,
            cage=cage,
            output=output,
            binding=binding,
            cache=cache,
            rest=rest,
            rest_frame=choose_rest_frame(rest, rest_frame),
            vertex_weights=vertex_weights,
            bind=bind,
            solve=solve,
            clip=replace(clip, missing=missing),
            overwrite=overwrite,
            resume=resume,
            on_bad_frame=on_bad_frame,
            keep_weights=not no_weights,
            scene=scene,
            memory=memory,
            jobs=jobs,
            build=build,
            cage_output=cage_output,
            fit=fit,
            capture=capture,
        )


def _check_no_cage_is_built(given: str) -> None:
    """Refuse options of a cage that is built, beside one that is given."""
    for name, option in (("cage_vertices", "--cage-vertices"), ("cage_output", "--cage-out")):
        if is_given(name):
            raise click.UsageError(
                f"{option} is for a cage that is built; leave out {option} or {given}"
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
    click.argument("frames", nargs=-1, required=True),
    click.option(
        "--cage",
        type=PATH_TYPE,
        help="The cage around the rest pose.  [default: one is built, as by cageik cage]",
    ),
    click.option(
        "--cage-vertices",
        type=int,
        default=BuildSettings().vertices,
        show_default=True,
        help="Vertices of the cage that is built, at most.",
    ),
    click.option(
        "--cage-out",
        "cage_output",
        type=PATH_TYPE,
        help="Write the cage that is built to this .obj file.",
    ),
    click.option(
        "--binding",
        type=PATH_TYPE,
        help="Take the weights and the cage from this file of cageik bind.",
    ),
    click.option(
        "-o",
        "--output",
        type=PATH_TYPE,
        default="cages.h5",
        show_default=True,
        help="The result file.",
    ),
    rest_option,
    rest_frame_option,
    BIND_OPTIONS,
    CACHE_OPTIONS,
    SOLVE_OPTIONS,
    FIT_OPTIONS,
    vertex_weights_option,
    CAPTURE_OPTIONS,
    click.option(
        "--missing", is_flag=True, help="Take vertices whose position is nan as missing data."
    ),
    SCENE_OPTIONS,
    click.option(
        "--no-weights", is_flag=True, help="Do not store the weights in the result (smaller file)."
    ),
    CLIP_OPTIONS,
    click.option(
        "--resume",
        is_flag=True,
        help="Continue an interrupted run from its checkpoint; start if there is none.",
    ),
    click.option(
        "--on-bad-frame",
        type=click.Choice(["stop", "skip"]),
        default="stop",
        show_default=True,
        help="If a frame cannot be read: stop, or leave a gap and report it.",
    ),
    overwrite_option,
    memory_option,
    jobs_option,
)


@click.command("extract")
@EXTRACT_OPTIONS
@click.option(
    "--export",
    "exports",
    type=PATH_TYPE,
    multiple=True,
    help="Also write the cages to this file, as cageik export does; may be repeated.",
)
@LIMIT_OPTIONS
@timings_option
@common_options
def extract_command(
    settings: "ExtractSettings",
    exports: tuple[Path, ...],
    limits: LimitOptions,
    timings: Path | None,
    quiet: bool,
) -> None:
    """Extract the cage of every frame.

    FRAMES are meshes of one connectivity: files, folders and globs (.obj, .ply, .off, each also
    .gz), in natural order of their names, or one file that contains a clip (.h5, .npz, .npy, .mdd,
    .pc2, .anime, .usd*, .abc). FILE::CLIP names one of several clips in a file.

    \b
    cageik extract frames --fit
    cageik extract frames --cage-vertices 150
    cageik extract frames --cage cage.obj --on-bad-frame skip
    cageik extract body.pc2 --rest body.obj --cage cage.obj --resume
    cageik extract shot.usdc::/hero/body --cage cage.obj --frames 0:48
    """  # noqa: D301
    from cageik_cli.cli.progress import show_progress
    from cageik_cli.report.overview import build_clip_entry, build_overview
    from cageik_cli.report.record import build_report
    from cageik_cli.report.views.text import format_text
    from cageik_cli.util.text import format_row
    from cageik_cli.workflows.extract import extract

    loaded_limits = limits.load()
    export_settings = _plan_exports(settings, exports, [timings], [limits.baseline])
    with show_progress(not quiet, timings, settings.overwrite) as progress:
        result = extract(settings, progress)
        summaries = _export(export_settings, progress)
    report = build_report(result, loaded_limits)
    overview = build_overview([build_clip_entry(report)])
    if quiet:
        echo_exceeded_limits(overview)
    else:
        lines = [format_text(report, bool(get_verbosity())), *map(format_row, progress.make_rows())]
        lines += [one.message for one in summaries]
        if settings.cage_output is not None:
            lines.append(f"wrote {settings.cage_output}")
        click.echo("\n".join(lines), err=True)
        click.echo(f"wrote {settings.output}; next: cageik report {settings.output}", err=True)
    if get_verbosity():
        _show_details(settings, result)
    exit_with_code(overview)


def _plan_exports(
    settings: "ExtractSettings",
    exports: tuple[Path, ...],
    other_outputs: list[Path | None],
    other_inputs: list[Path | None],
) -> list["ExportSettings"]:
    """Make the settings of the exports, and check the outputs of the command before any work."""
    from cageik_cli.util.outputs import check_no_overlap

    planned = _make_export_settings(settings, exports) if exports else []
    exported = [path for one in planned for path in one.outputs()]
    outputs = [*settings.outputs(), *other_outputs, *exported]
    check_no_overlap(outputs, [*settings.inputs(), *other_inputs])
    if planned:
        from cageik_cli.workflows.export import check_export

        for one in planned:
            check_export(one)
    return planned


def _make_export_settings(
    settings: "ExtractSettings", exports: tuple[Path, ...]
) -> list["ExportSettings"]:
    from cageik_cli.formats.write import Output
    from cageik_cli.workflows.export import ExportSettings

    return [
        ExportSettings(settings.output, Output(path, overwrite=settings.overwrite))
        for path in exports
    ]


def _export(planned: list["ExportSettings"], progress: "ProgressListener") -> list["ExportSummary"]:
    if not planned:
        return []
    from cageik_cli.workflows.export import export

    return [export(one, progress) for one in planned]


def _show_details(settings: "ExtractSettings", result: "Result") -> None:
    click.echo(f"cache: {settings.cache}", err=True)
    click.echo(f"settings: {json.dumps(result.settings)}", err=True)
    click.echo(f"sources: {json.dumps(result.sources)}", err=True)
