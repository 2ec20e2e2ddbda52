"""`cageik batch`: every clip under some folders, and one report over all."""

import os
from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.batch_config import PER_CLIP_OPTIONS, plan_batch
from cageik_cli.cli.options.common import PATH_TYPE, common_options, is_on_command_line
from cageik_cli.cli.options.limits import echo_exceeded_limits, exit_with_code
from cageik_cli.util.threads import count_processors


@click.command("batch")
@click.argument("folders", nargs=-1, required=True, type=PATH_TYPE)
@click.option(
    "-o", "--output", type=PATH_TYPE, required=True, help="The folder of all results and reports."
)
@click.option(
    "--exclude",
    metavar="PATTERN",
    multiple=True,
    help="Leave out clips whose names, as they are listed, match this, such as 'tests/*'; may be "
    "repeated.",
)
@click.option(
    "--resume",
    is_flag=True,
    help="Go on: leave clips that are done and unchanged, do the rest and those whose files or "
    "settings changed.",
)
@click.option("--overwrite", is_flag=True, help="Replace what is there: do all clips again.")
@click.option(
    "--pages/--no-pages",
    default=True,
    show_default=True,
    help="Write an HTML page a clip, which index.html links to.",
)
@click.option(
    "--scheduler",
    help="The Dask scheduler that does the work, tcp://HOST:PORT.  "
    "[default: DASK_SCHEDULER_ADDRESS, or processes of this machine]",
)
@click.option("--dry-run", is_flag=True, help="List what would be done, and do nothing.")
@click.option(
    "--jobs",
    type=click.IntRange(min=1),
    default=count_processors,
    show_default="processors",
    help="Clips that are extracted at a time, each in a process of its own.",
)
@common_options
def batch_command(folders: tuple[Path, ...], **options: Any) -> None:
    """Extract every clip under FOLDERS, in parallel, with one report over all.

    A clip is a series of numbered meshes in a folder, or a file that holds one or more. Options
    of extract given here are for all clips; a cageik.toml beside or above clips sets them for
    those. A clip that fails leaves the others alone. The output holds index.html, report.json,
    clips.csv, junit.xml and report.md, and under clips/ the result of each.

    \b
    cageik batch animations --cage rest_cage.obj -o out
    cageik batch walks runs -o out --resume --max-rms 0.5%
    """  # noqa: D301
    from cageik_cli.cli.github_summary import append_step_summary
    from cageik_cli.cli.progress import LineLogger, show_progress
    from cageik_cli.report.views.markdown import format_markdown
    from cageik_cli.workflows.batch.run import check_batch_folder, check_folder_empty, run_batch

    output: Path = options["output"].absolute()
    if not options["overwrite"]:
        (check_batch_folder if options["resume"] else check_folder_empty)(output)
    batch = plan_batch(folders, output, options)
    if options["dry_run"]:
        from cageik_cli.workflows.batch.dry_run import dry_run_lines

        click.echo("\n".join(dry_run_lines(batch)))
        return
    scheduler = _choose_scheduler(options)
    with show_progress(not options["quiet"], None, False, LineLogger) as progress:
        overview = run_batch(batch, scheduler, progress)
    append_step_summary(format_markdown(overview))
    _show_overview(overview, options["quiet"])
    if not options["quiet"]:
        click.echo(f"wrote {options['output'] / 'index.html'}", err=True)
    exit_with_code(overview)


batch_command.params += PER_CLIP_OPTIONS


def _choose_scheduler(options: dict[str, Any]) -> Any:
    """Who does the jobs."""
    address = options["scheduler"] or os.environ.get("DASK_SCHEDULER_ADDRESS")
    if address:
        if is_on_command_line("jobs"):
            raise click.UsageError("--jobs is of this machine; the cluster's workers are its own")
        from cageik_cli.workflows.batch.dask_cluster import DaskScheduler

        return DaskScheduler(address)
    from cageik_cli.workflows.batch.processes import ProcessScheduler

    return ProcessScheduler(options["jobs"])


def _show_overview(overview: Any, quiet: bool) -> None:
    """How the batch ended: in numbers, and why each clip failed or is over a limit."""
    failed = [entry for entry in overview.clips if entry.has_failed]
    over = [entry for entry in overview.clips if entry.exceeds_limit]
    if not quiet:
        done = len(overview.clips) - len(failed)
        text = f"{len(overview.clips)} clips: {done} done, {len(failed)} failed"
        click.echo(f"{text}, {len(over)} over a limit", err=True)
    for entry in failed:  # again, as they are far above in a long log
        click.echo(f"{entry.name}: {entry.fault}", err=True)
    echo_exceeded_limits(overview)
