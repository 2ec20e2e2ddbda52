"""`cageik batch`: every clip under some folders, and one report over all."""

import os
from typing import TYPE_CHECKING

import click

from cageik_cli.cli.batch_plan import SHARED_OPTIONS, BatchOptions, SharedOptions, plan_batch
from cageik_cli.cli.command import GroupedCommand, option
from cageik_cli.cli.group import spell_options
from cageik_cli.cli.options import common_options, count_processors
from cageik_cli.cli.options.group import OptionGroup, is_on_command_line, list_options
from cageik_cli.cli.output import (
    LineLogger,
    append_step_summary,
    echo_exceeded_limits,
    exit_with_code,
    show_progress,
)
from cageik_cli.util.settings import HelpGroup
from cageik_cli.util.text import format_count, single_line

if TYPE_CHECKING:
    from cageik_cli.batch.jobs import Scheduler
    from cageik_cli.report.overview import Overview


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
    help="List what would be done, and change nothing; exit code 1 if a clip would fail.",
)
@option(
    "--jobs",
    type=click.IntRange(min=1),
    default=count_processors,
    show_default="processors",
    group=HelpGroup.RUNNING,
    help="Number of processes; each extracts one clip at a time.",
)
@common_options
@SHARED_OPTIONS
def batch_command(
    options: BatchOptions,
    shared: SharedOptions,
    scheduler: str | None,
    dry_run: bool,
    jobs: int,
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
    from cageik_cli.batch.run import describe_batch, run_batch
    from cageik_cli.report.views.markdown import format_markdown

    batch = plan_batch(options, shared)
    for note in batch.notes if not quiet else ():
        click.echo(f"note: {note}", err=True)
    if dry_run:
        _show_dry_run(describe_batch(batch))
        return
    chosen = _choose_scheduler(scheduler, jobs, quiet)
    with show_progress(not quiet, None, False, LineLogger) as progress:
        overview = run_batch(batch, chosen, progress, spell_options)
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
    from cageik_cli.batch.processes import ProcessScheduler

    return ProcessScheduler(jobs)


def _show_dry_run(clips: dict[str, list[tuple[str, str]]]) -> None:
    """Print what would be done; exit with 1 if a clip would fail."""
    from cageik_cli.batch.run import FAULT_LABEL
    from cageik_cli.util.text import format_block, format_count

    failing = sum(rows[0][0] == FAULT_LABEL for rows in clips.values())
    lines = [spell_options(format_block(name, rows)) for name, rows in clips.items()]
    lines.append(f"{failing} of {format_count(len(clips), 'clip')} would fail")
    click.echo("\n".join(lines))
    if failing:
        raise click.exceptions.Exit(1)


def _show_overview(overview: "Overview", quiet: bool) -> None:
    """Print the counts, which clips are poor, and why others failed or are above a limit."""
    from cageik_cli.report.overview import describe_poor

    failed = [entry for entry in overview.clips if entry.has_failed]
    over = [entry for entry in overview.clips if entry.exceeds_limit]
    if not quiet:
        clips, done = format_count(len(overview.clips), "clip"), len(overview.clips) - len(failed)
        text = f"{clips}: {done} done, {len(failed)} failed, {len(over)} over a limit"
        poor = sum(entry.is_poor for entry in overview.clips)
        click.echo(f"{text}, {poor} poor" if poor else text, err=True)
        for sentence in describe_poor(overview.worst_first):
            click.echo(sentence, err=True)
        if failed:
            click.echo("failed clips are done again, and no others, with --resume", err=True)
    for entry in failed:  # at the end, where a long log is looked at
        click.echo(f"{entry.label}: {entry.fault}", err=True)
    echo_exceeded_limits(overview)
