"""`cageik batch`: every clip under some folders, and one report over all."""

import os
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from cageik_cli.cli.clip_tables import NAME, ClipTables, is_path
from cageik_cli.cli.extract import extract_command, extract_settings
from cageik_cli.cli.gate_options import echo_over_limits, exit_by, limits_of
from cageik_cli.cli.options import PATH, common, is_typed
from cageik_cli.errors import CageikError
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
    "--exclude", multiple=True, help="Leave out clips of names like this; may be repeated."
)
@click.option(
    "--resume",
    is_flag=True,
    help="Leave what is done of the same files and settings; do the rest, and what changed.",
)
@click.option("--overwrite", is_flag=True, help="Replace what is there.")
@click.option(
    "--pages/--no-pages", default=True, show_default=True, help="Write a page a clip, too."
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

    A clip is a folder of two or more frames, or a file that holds one. Options of extract hold for
    all clips, or for some in a cageik.toml beside or above them. One that fails leaves the others
    alone. In the folder of the output are index.html, report.json, clips.csv, junit.xml and
    report.md, and under clips/ a result a clip.

    \b
    cageik batch animations --cage rest_cage.obj -o out
    cageik batch walks runs -o out --resume --max-rms 0.5%
    """  # noqa: D301
    from cageik_cli.batch.running import refuse_foreign, refuse_used, run_batch
    from cageik_cli.cli.step_summary import append_step_summary
    from cageik_cli.cli.watching import Lines, watched
    from cageik_cli.report import as_markdown

    output: Path = options["output"].absolute()
    if not options["overwrite"]:
        (refuse_foreign if options["resume"] else refuse_used)(output)
    batch = _batch([_placed(folder) for folder in folders], output, options)
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
    from cageik_cli.batch.running import VIEWS, WEIGHTS, Batch, refuse_no_result
    from cageik_cli.layout import printable
    from cageik_cli.outputs import keep_apart
    from cageik_cli.report import Entry, read_baseline

    read = cache(read_baseline)
    tables = ClipTables(extract_command)
    own, base = _typed()
    files = [value for name, value in (base | own).items() if is_path(extract_command, name)]
    named = {Path(file).resolve() for file in files if file is not None}
    for root in folders:
        _refuse_results(root, output)
        named.update(*(tables.paths(folder) for folder in folders_under(root, output)))
    keep_apart([output / name for name in VIEWS], list(named))
    found = clips_under(folders, Search(frozenset(named), output, options["exclude"]))
    jobs, refused = [], []
    for clip in found:
        try:
            given = base | tables.given(clip.home, clip.place)
            settings, limits = _settings(clip, given, own, read)
            place = output / CLIPS / f"{clip.name}.h5"
            if not options["overwrite"]:
                refuse_no_result(place)
        except (click.UsageError, CageikError) as error:
            text = error.format_message() if isinstance(error, click.UsageError) else str(error)
            refused.append(Entry(clip.name, fault=printable(" ".join(text.split()))))
            continue
        settings = replace(
            settings,
            output=place,
            cache=settings.cache or output / WEIGHTS,
            resume=options["resume"] or not options["overwrite"],
            overwrite=options["resume"] or options["overwrite"],
        )
        jobs.append(ClipJob(clip.name, settings, limits, options["pages"]))
    order = tuple(clip.name for clip in found)
    return Batch(output, tuple(jobs), tuple(refused), order)


def _refuse_results(folder: Path, output: Path) -> None:
    """Refuse to look for clips where the results are to be."""
    from cageik_cli.batch.jobs import CLIPS

    place, results = folder.resolve(), output.resolve() / CLIPS
    if place == output.resolve() or results in (place, *place.parents):
        raise click.UsageError(f"{folder}: is where the results would be; name another with -o")


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


def _placed(folder: Path) -> Path:
    """A folder's absolute path, whose parents are the folders above it."""
    return folder.resolve() if ".." in folder.parts else folder.absolute()


def _settings(clip: Any, given: dict[str, Any], own: dict[str, Any], read: Any) -> Any:
    """What `cageik extract` would make of the clip, options of files, and those that are typed."""
    for name in given:
        if name in OWN:
            raise click.UsageError(f"{name} is an option of cageik batch, not of a clip in {NAME}")
    given = given | own
    if given.get("cage") is None and given.get("binding") is None:
        raise click.UsageError(
            f"no cage is named for it; give --cage, or name one in a {NAME} in its folder or above"
        )
    with extract_command.make_context("extract", list(clip.frames), default_map=given) as context:
        for name in own:
            context.set_parameter_source(name, ParameterSource.COMMANDLINE)
        options = dict(context.params)
        for name in OWN:
            options.pop(name, None)
        limits = limits_of(options, read).by_name()
        return extract_settings(options | {"output": Path()}), limits


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
    for entry in failed if quiet else ():  # else each was told when it ended
        click.echo(f"{entry.name}: {entry.fault}", err=True)
    echo_over_limits(overview)
