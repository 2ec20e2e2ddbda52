"""`cageik batch`: every clip under some folders, and one report over all.

Its plan is the clips that are found, each with the options that apply to it.
"""

import os
from collections.abc import Callable
from copy import copy
from dataclasses import MISSING, dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from cageik_cli.cli.command import GroupedCommand, GroupedOption, option, spell_param
from cageik_cli.cli.config import CONFIG_NAME, ClipTables, is_auxiliary_path, list_commands
from cageik_cli.cli.extract import EXTRACT_OPTIONS, extract_command
from cageik_cli.cli.group import spell_message, spell_option
from cageik_cli.cli.options import common_options, count_processors, timings_option
from cageik_cli.cli.options.group import Decorator, OptionGroup, is_on_command_line, list_options
from cageik_cli.cli.options.limits import LIMIT_OPTIONS
from cageik_cli.cli.output import (
    LineLogger,
    append_step_summary,
    echo_exceeded_limits,
    exit_with_code,
    show_progress,
)
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.util.errors import CageikError, SettingError, WrongUsageError
from cageik_cli.util.messages import Row, say
from cageik_cli.util.settings import HelpGroup, declare_setting
from cageik_cli.util.text import format_count, single_line

if TYPE_CHECKING:
    from cageik_cli.batch.discover import DiscoveredClip
    from cageik_cli.batch.jobs import ClipJob, Scheduler
    from cageik_cli.batch.run import BatchPlan
    from cageik_cli.cli.options.limits import LoadBaseline
    from cageik_cli.report.limits import Limits
    from cageik_cli.report.overview import Overview
    from cageik_cli.run.settings import ExtractSettings


@dataclass(frozen=True, slots=True)
class BatchOptions:
    """The options of the batch itself, as they were typed."""

    folders: tuple[Path, ...] = declare_setting(MISSING, "", option="FOLDERS")
    output: Path = declare_setting(
        MISSING, "Folder for all results and reports.", option="-o/--output"
    )
    exclude_clips: tuple[str, ...] = declare_setting(
        (),
        "Leave out clips whose listed names, or paths below FOLDER, match this pattern, such as "
        "'tests/*'; may be repeated.",
        option="--exclude",
        metavar="PATTERN",
        group=HelpGroup.CLIP,
    )
    resume: bool = declare_setting(False, "Continue: extract new, changed and failed clips.")
    overwrite: bool = declare_setting(False, "Extract all clips again, and replace the outputs.")
    shared_fit: bool = declare_setting(
        False,
        "Fit one set of weights to all clips of a model, in the cage and the rest pose of the "
        "first, so that export --skeleton makes one rig of their results.",
        group=HelpGroup.FIT,
    )
    pages: bool = declare_setting(
        True, "Write one HTML page per clip, linked from index.html.", group=HelpGroup.WRITTEN
    )
    player: bool = declare_setting(
        False,
        "Play the clip and pose its model on each page, which is then about 2 MB larger.",
        option="--player/--no-player",
        group=HelpGroup.WRITTEN,
    )


@dataclass(frozen=True, slots=True)
class SharedOptions:
    """The options for all clips, by the names of parameters.

    Attributes
    ----------
    command_line : dict
        They win over the files of options beside clips.
    config_file : dict
        From the file of `--config`; files beside clips win over them.
    """

    command_line: dict[str, Any]
    config_file: dict[str, Any]

    @staticmethod
    def collect(**values: Any) -> "SharedOptions":
        """Collect those that are given, from where they are; paths become absolute."""
        context = click.get_current_context()

        def collect(source: ParameterSource) -> dict[str, Any]:
            return {
                name: str(value.absolute()) if isinstance(value, Path) else value
                for name, value in values.items()
                if context.get_parameter_source(name) is source
            }

        typed = collect(ParameterSource.COMMANDLINE)
        for param in context.command.params:
            if isinstance(param, GroupedOption) and param.name in typed:
                for other, message in param.setting.excludes:
                    if other in typed:  # in every clip alike, so before any is searched for
                        raise click.UsageError(spell_message(say(message).format(**typed)))
        return SharedOptions(typed, collect(ParameterSource.DEFAULT_MAP))

    def find_auxiliary_files(self) -> set[Path]:
        """Return the files that the options name and that are no frames."""
        from cageik_cli.formats.find_files import Source

        return {
            Source.parse(file).file.resolve()
            for name, file in (self.config_file | self.command_line).items()
            if file is not None and is_auxiliary_path(extract_command, name, file)
        }


def _repeat_option(option: GroupedOption) -> Decorator:
    """Make the decorator that adds an option of another command.

    What the option needs may stand in a file of options beside a clip.
    """
    option = copy(option)
    option.setting = replace(option.setting, needs=None)

    def add(command: Callable[..., Any]) -> Callable[..., Any]:
        command.__dict__.setdefault("__click_params__", []).append(option)
        return command

    return add


SHARED_OPTIONS = OptionGroup(
    "shared",
    SharedOptions.collect,
    *(
        _repeat_option(option)
        for option in extract_command.params
        if isinstance(option, GroupedOption)
        and option.setting.is_per_clip
        and option.name != "exclude"
    ),
    *list_options(ClipSettings, {"exclude": {"option": "--exclude-parts"}}),
)


@click.command("batch", cls=GroupedCommand)
@OptionGroup("options", BatchOptions, *list_options(BatchOptions))
@option(
    "--scheduler",
    help="Dask scheduler that runs the jobs, tcp://HOST:PORT.  "
    "[default: DASK_SCHEDULER_ADDRESS, or processes of this machine]",
    group=HelpGroup.RUNNING,
)
@option(
    "--dry-run",
    is_flag=True,
    help="List what would be done; exit code 1 if a clip fails.",
)
@option(
    "--jobs",
    type=click.IntRange(min=1),
    default=count_processors,
    show_default="processors",
    group=HelpGroup.RUNNING,
    help="Number of processes; each extracts one clip at a time.",
)
@timings_option
@common_options
@SHARED_OPTIONS
def batch_command(
    options: BatchOptions,
    shared: SharedOptions,
    scheduler: str | None,
    dry_run: bool,
    jobs: int,
    timings: Path | None,
    quiet: bool,
) -> None:
    """Extract every clip under some folders.

    A clip is a series of numbered meshes in a folder, or a file that contains one or more clips.
    Options of extract apply to all clips; a cageik.toml beside or above clips sets options for
    those. If a clip fails, the others are still extracted. The output folder has index.html,
    report.json, clips.csv, junit.xml and report.md, and one result per clip in clips/.

    \b
    cageik batch animations --cage rest_cage.obj -o out
    cageik batch walks runs -o out --resume --max-rms 0.5%
    """  # noqa: D301
    from cageik_cli.batch.jobs import CLIPS_FOLDER
    from cageik_cli.batch.run import REPORT_FILES, describe_batch, run_batch
    from cageik_cli.report.views.markdown import format_markdown
    from cageik_cli.util.outputs import check_no_overlap

    batch = plan_batch(options, shared)
    written = [options.output / name for name in (CLIPS_FOLDER, *REPORT_FILES)]
    check_no_overlap([*written, timings], batch.inputs)
    for note in batch.notes if not quiet else ():
        click.echo(f"note: {note}", err=True)
    if dry_run:
        _show_dry_run(describe_batch(batch))
        return
    chosen = _choose_scheduler(scheduler, jobs, quiet)
    with show_progress(
        not quiet, timings, options.overwrite, LineLogger, resume=options.resume
    ) as progress:
        overview = run_batch(batch, chosen, progress, spell_option, is_timed=timings is not None)
    append_step_summary(format_markdown(overview))
    _show_overview(overview, quiet)
    if not quiet:
        click.echo(f"wrote {options.output / 'index.html'}", err=True)
    exit_with_code(overview)


def _choose_scheduler(given: str | None, jobs: int, quiet: bool) -> "Scheduler":
    """Return what runs the jobs: a Dask scheduler if there is an address, else processes."""
    address = given or os.environ.get("DASK_SCHEDULER_ADDRESS")
    if address:
        if is_on_command_line("jobs"):
            raise click.UsageError(
                "--jobs applies to local runs only; leave it out with --scheduler"
            )
        from cageik_cli.batch.dask_cluster import DaskScheduler

        if not quiet:
            source = "" if given else ", of DASK_SCHEDULER_ADDRESS"
            click.echo(f"note: jobs go to the scheduler {single_line(address)}{source}", err=True)
        return DaskScheduler(address)
    from cageik_cli.batch.run import ProcessScheduler

    return ProcessScheduler(jobs)


def _show_dry_run(clips: dict[str, list[Row]]) -> None:
    """Print what would be done; exit with 1 if a clip would fail."""
    from cageik_cli.batch.run import FAULT_LABEL
    from cageik_cli.cli.output import spell_rows
    from cageik_cli.util.text import format_block, format_count

    failing = sum(rows[0][0] == FAULT_LABEL for rows in clips.values())
    lines = [format_block(name, spell_rows(rows)) for name, rows in clips.items()]
    lines.append(f"{failing} of {format_count(len(clips), 'clip')} would fail")
    click.echo("\n".join(lines))
    if failing:
        raise click.exceptions.Exit(1)


def _show_overview(overview: "Overview", quiet: bool) -> None:
    """Print the counts, which clips are poor, and why others failed or are above a limit."""
    from cageik_cli.report.overview import describe_poor
    from cageik_cli.report.vocabulary import QUALITY_WORDS

    failed = [entry for entry in overview.clips if entry.has_failed]
    over = [entry for entry in overview.clips if entry.exceeds_limit]
    if not quiet:
        clips, done = format_count(len(overview.clips), "clip"), len(overview.clips) - len(failed)
        text = f"{clips}: {done} done, {len(failed)} failed, {len(over)} over a limit"
        poor = sum(entry.is_poor for entry in overview.clips)
        click.echo(f"{text}, {poor} {QUALITY_WORDS['poor']}" if poor else text, err=True)
        for sentence in describe_poor(overview.worst_first):
            click.echo(sentence, err=True)
        if failed:
            click.echo("failed clips are done again, and no others, with --resume", err=True)
    for entry in failed:  # at the end, where a long log is looked at
        click.echo(f"{entry.label}: {entry.fault}", err=True)
    echo_exceeded_limits(overview)


def plan_batch(options: BatchOptions, shared: SharedOptions) -> "BatchPlan":
    """Find the clips, and make one job for each.

    Raises
    ------
    click.UsageError
        When one of the folders is where the results would be.
    InputError
        When there is no clip, no clip can be started for one and the same reason, or the output
        folder is in use.
    """
    from cageik_cli.batch.run import BatchPlan, check_batch_folder, check_folder_empty
    from cageik_cli.report.limits import read_baseline
    from cageik_cli.report.overview import ClipEntry
    from cageik_cli.util.text import to_unicode

    options = replace(options, output=options.output.absolute())
    if not options.overwrite:
        (check_batch_folder if options.resume else check_folder_empty)(options.output)
    commands = list_commands(click.get_current_context())
    tables = ClipTables(extract_command, commands, options.folders)
    notes: list[str] = []
    found = _find_clips(options, shared, tables, notes.append)
    load_baseline = cache(read_baseline)
    jobs, inputs, rejected, is_wrong_usage = [], [], [], False
    for clip in found:
        try:
            collected = tables.collect_options(clip.folder, clip.path)
            given = replace(shared, config_file=shared.config_file | collected)
            settings, limits = _make_clip_settings(clip, given, load_baseline)
            if options.shared_fit:
                _check_shared_fit(settings)
            job = _make_job(clip, settings, limits, options)
            inputs += job.settings.inputs()
            jobs.append(job)
        except (click.UsageError, CageikError) as error:
            rejected.append(ClipEntry(clip.name, fault=to_unicode(_describe_fault(error))))
            is_wrong_usage = isinstance(error, click.UsageError | WrongUsageError)
    if not jobs and len({entry.fault for entry in rejected}) == 1:
        message = f"none of {len(found)} clips can be started: {rejected[0].fault}"
        raise click.UsageError(message) if is_wrong_usage else SettingError(message)
    order = tuple(clip.name for clip in found)
    jobs = [replace(job, limits=job.limits.match_several(order)) for job in jobs]
    return BatchPlan(
        options.output,
        tuple(jobs),
        tuple(rejected),
        order,
        tuple(inputs),
        tuple(notes),
        options.shared_fit,
    )


def _check_shared_fit(settings: "ExtractSettings") -> None:
    """Refuse options of a clip that leave no weights to fit."""
    others = {
        "--binding": settings.binding is not None,
        "--no-fit": settings.fit is False,
        "--no-weights": not settings.keep_weights,
        "options of captured data": settings.is_captured,
    }
    for other, is_given in others.items():
        if is_given:
            raise click.UsageError(f"--shared-fit does not go with {other}; leave out one of them")


def _find_clips(
    options: BatchOptions,
    shared: SharedOptions,
    tables: ClipTables,
    note: Callable[[str], None],
) -> list["DiscoveredClip"]:
    """Find the clips under the folders; files that options name are none."""
    from cageik_cli.batch.discover import discover_clips, walk_folders
    from cageik_cli.batch.run import REPORT_FILES
    from cageik_cli.util.outputs import check_no_overlap

    auxiliary_files = shared.find_auxiliary_files()
    roots = [_make_absolute(folder) for folder in options.folders]
    for root in roots:
        _check_not_results(root, options.output)
        for folder in walk_folders(root, options.output):
            auxiliary_files |= tables.find_auxiliary_files(folder)
    check_no_overlap([options.output / name for name in REPORT_FILES], list(auxiliary_files))
    return discover_clips(
        roots,
        output=options.output,
        auxiliary_files=auxiliary_files,
        exclude=options.exclude_clips,
        note=note,
    )


def _make_job(
    clip: "DiscoveredClip", settings: "ExtractSettings", limits: "Limits", options: BatchOptions
) -> "ClipJob":
    """Make the job of a clip, whose result goes to the folder of the batch."""
    from cageik_cli.batch.jobs import CLIPS_FOLDER, ClipJob
    from cageik_cli.batch.run import WEIGHT_CACHE_FOLDER, check_is_result

    place = options.output / CLIPS_FOLDER / clip.result
    if not options.overwrite:
        check_is_result(place)
    settings = replace(
        settings,
        output=place,
        cache=settings.cache or options.output / WEIGHT_CACHE_FOLDER,
        resume=options.resume or not options.overwrite,
        overwrite=options.resume or options.overwrite,
        jobs=1,
    )
    job = ClipJob(clip.name, settings, limits, options.pages)
    if options.player:
        from cageik_cli.view.player.section import load_player

        job = replace(job, load_player=load_player)
    return job


def _check_not_results(folder: Path, output: Path) -> None:
    """Refuse to search for clips where the results go."""
    from cageik_cli.batch.jobs import CLIPS_FOLDER

    place, results = folder.resolve(), output.resolve() / CLIPS_FOLDER
    if place == output.resolve() or results in (place, *place.parents):
        raise click.UsageError(
            f"{folder}: is the folder of the results; choose another one with -o"
        )


def _make_absolute(folder: Path) -> Path:
    """Make a path absolute, so that its parents are the folders above it."""
    return folder.resolve() if ".." in folder.parts else folder.absolute()


def _make_clip_settings(
    clip: "DiscoveredClip",
    options: SharedOptions,
    load_baseline: "LoadBaseline",
) -> tuple["ExtractSettings", "Limits"]:
    """Make the settings and limits that `cageik extract` would make of the same options."""
    from cageik_cli.formats.timeline import check_any_frame

    given = options.config_file | options.command_line
    parent = click.get_current_context().parent
    with extract_command.make_context(
        "extract", list(clip.frames), parent=parent, default_map=given
    ) as context:
        for name in options.command_line:
            context.set_parameter_source(name, ParameterSource.COMMANDLINE)
        limits = LIMIT_OPTIONS.make_record(context.params).load(load_baseline)
        settings = EXTRACT_OPTIONS.make_record(context.params)
        check_any_frame(settings.clip.selection)
        return settings, limits


def _describe_fault(error: click.UsageError | CageikError) -> str:
    """Say why a clip cannot be started; values of the command line were checked before."""
    if isinstance(error, click.BadParameter) and error.param is not None:
        option = spell_param(error.param)
        return f"{option} of a {CONFIG_NAME} in its folder or above: {error.message.rstrip('.')}"
    return error.message if isinstance(error, click.UsageError) else spell_message(error.text)
