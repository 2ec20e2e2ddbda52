"""The clips of a batch, each with the options of `cageik extract` that hold for it."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from cageik_cli.cli.clip_tables import NAME, ClipTables, is_no_frame
from cageik_cli.cli.config import commands_of
from cageik_cli.cli.extract import extract_command, extract_settings
from cageik_cli.cli.gate_options import limits_of
from cageik_cli.util.errors import CageikError, InputError

OWN = ("output", "exports", "overwrite", "resume", "timings", "jobs", "quiet", "config", "verbose")
"""Options of `extract` that a batch has of its own, or that are not for one clip of many."""

PER_CLIP = [
    option
    for option in extract_command.params
    if isinstance(option, click.Option) and option.name not in OWN
]


def batch_of(folders: tuple[Path, ...], output: Path, options: dict[str, Any]) -> Any:
    """What is to be done: a job a clip that is found.

    Raises
    ------
    click.UsageError
        When clips would be looked for among the results.
    InputError
        When there are none, or none can be begun for the same reason.
    """
    from cageik_cli.report.baseline import read_baseline
    from cageik_cli.report.overview import Entry
    from cageik_cli.util.outputs import keep_apart
    from cageik_cli.util.text import printable
    from cageik_cli.workflows.batch.discover import Search, clips_under, folders_under
    from cageik_cli.workflows.batch.jobs import CLIPS, ClipJob
    from cageik_cli.workflows.batch.run import VIEWS, WEIGHTS, Batch, refuse_no_result

    read = cache(read_baseline)
    tables = ClipTables(extract_command, commands_of(click.get_current_context()), OWN)
    own, base = _typed()
    files = [value for name, value in (base | own).items() if is_no_frame(extract_command, name)]
    named = {Path(file).resolve() for file in files if file is not None}
    roots = [_placed(folder) for folder in folders]
    for root in roots:
        _refuse_results(root, output)
        named.update(*(tables.paths(folder) for folder in folders_under(root, output)))
    keep_apart([output / name for name in VIEWS], list(named))
    found = clips_under(roots, Search(frozenset(named), output, options["exclude"]))
    jobs, refused = [], []
    for clip in found:
        try:
            given = base | tables.given(clip.home, clip.place)
            settings, limits = _settings(clip, given, own, read)
            place = output / CLIPS / f"{clip.name}.h5"
            if not options["overwrite"]:
                refuse_no_result(place)
        except (click.UsageError, CageikError) as error:
            refused.append(Entry(clip.name, fault=printable(_fault(error))))
            continue
        settings = replace(
            settings,
            output=place,
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


def _refuse_results(folder: Path, output: Path) -> None:
    """Refuse to look for clips where the results are to be."""
    from cageik_cli.workflows.batch.jobs import CLIPS

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
    given = given | own
    if given.get("cage") is None and given.get("binding") is None:
        raise click.UsageError(
            f"no cage is named for it; give --cage, or name one in a {NAME} in its folder or above"
        )
    parent = click.get_current_context().parent
    with extract_command.make_context(
        "extract", list(clip.frames), parent=parent, default_map=given
    ) as context:
        for name in own:
            context.set_parameter_source(name, ParameterSource.COMMANDLINE)
        options = dict(context.params)
        for name in OWN:
            options.pop(name, None)
        limits = limits_of(options, read).by_name()
        return extract_settings(options | {"output": Path()}), limits


def _fault(error: click.UsageError | CageikError) -> str:
    """Why a clip cannot be begun; values of the command line have been checked by then."""
    if isinstance(error, click.BadParameter) and error.param is not None:
        option = max(error.param.opts, key=len)
        return f"{option} of a {NAME} in its folder or above: {error.message.rstrip('.')}"
    return error.message if isinstance(error, click.UsageError) else str(error)
