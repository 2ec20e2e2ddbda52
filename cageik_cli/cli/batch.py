"""`cageik batch`: every clip under some folders, and one report over all."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from cageik_cli.cli.clip_tables import NAME, ClipTables, is_path
from cageik_cli.cli.config import commands_of
from cageik_cli.cli.extract import extract_command, extract_settings
from cageik_cli.cli.gate_options import echo_over_limits, exit_by, limits_of
from cageik_cli.cli.options import PATH, common, is_typed
from cageik_cli.errors import CageikError, InputError
from cageik_cli.threads import processors

OWN = ("output", "exports", "overwrite", "resume", "timings", "jobs", "quiet", "config", "verbose")
"""Options of `extract` that a batch has of its own, or that are not for one clip of many."""

PER_CLIP = [
    option
    for option in extract_command.params
    if isinstance(option, click.Option) and option.name not in OWN
]


@click.command("batch")
@click.argument("folders", nargs=-1, required=True, type=PATH)
@click.option(
    "-o", "--output", type=PATH, required=True, help="The folder of all results and reports."
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
    default=processors,
    show_default="processors",
    help="Clips that are extracted at a time, each in a process of its own.",
)
@common
def batch_command(folders: tuple[Path, ...], **options: Any) -> None:
    """Extract every clip under FOLDERS, in parallel, with one report over all.

    A clip is a folder of two or more frames, or a file that holds one or more. Options of extract
    given here are for all clips; a cageik.toml beside or above clips sets them for those. A clip
    that fails leaves the others alone. The output holds index.html, report.json, clips.csv,
    junit.xml and report.md, and under clips/ the result of each.

    \b
    cageik batch animations --cage rest_cage.obj -o out
    cageik batch walks runs -o out --resume --max-rms 0.5%
    """  # noqa: D301
    from cageik_cli.batch.running import refuse_used, run_batch
    from cageik_cli.cli.step_summary import append_step_summary
    from cageik_cli.cli.watching import Lines, watched
    from cageik_cli.report import as_markdown

    output: Path = options["output"].absolute()
    if not (options["resume"] or options["overwrite"]):
        refuse_used(output)
    batch = _batch([folder.absolute() for folder in folders], output, options)
    if options["dry_run"]:
        from cageik_cli.batch.listing import listed

        click.echo("\n".join(listed(batch)))
        return
    scheduler = _scheduler(options)
    with watched(not options["quiet"], None, False, Lines) as watch:
        overview = run_batch(batch, scheduler, watch)
    append_step_summary(as_markdown(overview))
    _show(overview, options["quiet"])
    if not options["quiet"]:
        click.echo(f"wrote {options['output'] / 'index.html'}", err=True)
    exit_by(overview)


batch_command.params += PER_CLIP


def _batch(folders: list[Path], output: Path, options: dict[str, Any]) -> Any:
    """What is to be done: a job a clip that is found."""
    from cageik_cli.batch.finding import Search, clips_under, folders_under
    from cageik_cli.batch.jobs import CLIPS, ClipJob
    from cageik_cli.batch.running import WEIGHTS, Batch
    from cageik_cli.report import Entry

    tables = ClipTables(extract_command, commands_of(click.get_current_context()), OWN)
    own, base = _typed()
    named = {Path(own[name]).resolve() for name in own if is_path(extract_command, name)}
    for root in folders:
        named.update(*(tables.paths(folder) for folder in folders_under(root, output)))
    found = clips_under(folders, Search(frozenset(named), output, options["exclude"]))
    jobs, refused = [], []
    for clip in found:
        try:
            given = base | tables.given(clip.home, clip.place) | own
            settings, limits = _settings(clip, given)
        except (click.UsageError, CageikError) as error:
            refused.append(Entry(clip.name, fault=_fault(error)))
            continue
        settings = replace(
            settings,
            output=output / CLIPS / f"{clip.name}.h5",
            cache=settings.cache or output / WEIGHTS,
            resume=options["resume"] or not options["overwrite"],
            overwrite=options["resume"] or options["overwrite"],
        )
        jobs.append(ClipJob(clip.name, settings, limits, options["pages"]))
    faults = {entry.fault for entry in refused}
    if not jobs and len(faults) == 1:
        raise InputError(f"none of {len(found)} clips can be begun: {faults.pop()}")
    order = tuple(clip.name for clip in found)
    return Batch(output, tuple(jobs), tuple(refused), order)


def _typed() -> tuple[dict[str, Any], dict[str, Any]]:
    """The options for all clips: those of the command line, and those of its file of options."""
    context = click.get_current_context()
    values = {
        name: str(value.absolute()) if isinstance(value, Path) else value
        for name, value in context.params.items()
        if name in {option.name for option in PER_CLIP}
    }
    sources = {name: context.get_parameter_source(name) for name in values}
    own, base = (
        {name: value for name, value in values.items() if sources[name] is source}
        for source in (ParameterSource.COMMANDLINE, ParameterSource.DEFAULT_MAP)
    )
    return own, base


def _settings(clip: Any, given: dict[str, Any]) -> Any:
    """What `cageik extract` would make of the clip and these options."""
    if given.get("cage") is None and given.get("binding") is None:
        raise click.UsageError(
            f"no cage is named for it; give --cage, or name one in a {NAME} in its folder or above"
        )
    parent = click.get_current_context().parent
    with extract_command.make_context(
        "extract", list(clip.frames), parent=parent, default_map=given
    ) as context:
        options = dict(context.params)
        for name in OWN:
            options.pop(name, None)
        limits = limits_of(options).by_name()
        return extract_settings(options | {"output": Path()}), limits


def _fault(error: click.UsageError | CageikError) -> str:
    """Why a clip cannot be begun; values of the command line have been checked by then."""
    if isinstance(error, click.BadParameter) and error.param is not None:
        option = max(error.param.opts, key=len)
        return f"{option} of a {NAME} in its folder or above: {error.message.rstrip('.')}"
    return error.message if isinstance(error, click.UsageError) else str(error)


def _scheduler(options: dict[str, Any]) -> Any:
    """Who does the jobs."""
    address = options["scheduler"] or os.environ.get("DASK_SCHEDULER_ADDRESS")
    if address:
        if is_typed("jobs"):
            raise click.UsageError("--jobs is of this machine; the cluster's workers are its own")
        from cageik_cli.batch.cluster import Cluster

        return Cluster(address)
    from cageik_cli.batch.local import Processes

    return Processes(options["jobs"])


def _show(overview: Any, quiet: bool) -> None:
    """How the batch ended: in numbers, and why each clip failed or is over a limit."""
    failed = [entry for entry in overview.clips if entry.has_failed]
    over = [entry for entry in overview.clips if entry.exceeds]
    if not quiet:
        done = len(overview.clips) - len(failed)
        text = f"{len(overview.clips)} clips: {done} done, {len(failed)} failed"
        click.echo(f"{text}, {len(over)} over a limit", err=True)
    for entry in failed:  # again, as they are far above in a long log
        click.echo(f"{entry.name}: {entry.fault}", err=True)
    echo_over_limits(overview)
