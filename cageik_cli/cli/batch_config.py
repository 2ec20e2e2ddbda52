"""What each clip of a batch is given: options from `cageik.toml`, layer over layer.

A file in the clip's folder, or in one above it, may have a table `[extract]` for all clips there,
and tables `[clips."walks/*"]` for those whose path from that file's folder matches. The nearer file
wins, in a file the later table, and the command line over all. Paths are from the file's folder.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from fnmatch import fnmatch
from functools import cache
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from cageik_cli.cli.config import CLIPS, commands_of, options_of, read_tables, refuse_other_tables
from cageik_cli.cli.extract import extract_command, extract_settings
from cageik_cli.cli.options.limits import limits_of
from cageik_cli.util.errors import CageikError, InputError

NAME = "cageik.toml"
COMMAND = "extract"


class ClipTables:
    """The files of options, each read once.

    Parameters
    ----------
    command : click.Command
        With the options that a clip may be given.
    commands : sequence of str
        Whose tables a file may hold; only that of `command` is read.
    of_batch : sequence of str
        Options of `command` that are for the whole batch, by parameters' names.
    """

    def __init__(
        self, command: click.Command, commands: Sequence[str], of_batch: Sequence[str]
    ) -> None:
        self._command = command
        self._commands = commands
        self._of_batch = of_batch
        self._read: dict[Path, dict[str, Any]] = {}

    def given(self, home: Path, path: Path) -> dict[str, Any]:
        """What the clip at `path`, in the folder `home`, is given, by parameters' names.

        Raises
        ------
        click.BadParameter
            Naming the file that is at fault.
        """
        chosen: dict[str, Any] = {}
        for file in reversed(list(self._files(home))):
            name = path.relative_to(file.parent).as_posix()
            for title, table in self._tables(file):
                pattern = title.removeprefix(f"{CLIPS}.")
                if title == COMMAND or fnmatch(name, pattern):
                    chosen |= self._placed(file, title, table)
        return chosen

    def paths(self, folder: Path) -> set[Path]:
        """Every file that tables of this folder, or of those above it, name.

        A file that cannot be read names none; its clips are told.
        """
        named: set[Path] = set()
        for file in self._files(folder):
            try:
                tables = [self._placed(file, *table) for table in self._tables(file)]
            except click.UsageError:
                continue
            named.update(
                Path(value).resolve()
                for table in tables
                for name, value in table.items()
                if is_no_frame(self._command, name)
            )
        return named

    def _files(self, folder: Path) -> Iterator[Path]:
        """Those that count in a folder, its own first."""
        place = folder.absolute()
        return (above / NAME for above in (place, *place.parents) if (above / NAME).is_file())

    def _tables(self, file: Path) -> Iterator[tuple[str, Any]]:
        if file not in self._read:
            tables = read_tables(file)
            refuse_other_tables(file, tables, self._commands)
            self._read[file] = tables
        tables = self._read[file]
        if COMMAND in tables:
            yield COMMAND, tables[COMMAND]
        yield from (
            (f"{CLIPS}.{pattern}", table) for pattern, table in tables.get(CLIPS, {}).items()
        )

    def _placed(self, file: Path, title: str, table: Any) -> dict[str, Any]:
        """A table's options, paths made absolute."""
        chosen = options_of(file, title, table, self._command)
        for name in chosen:
            if name in self._of_batch:
                raise click.BadParameter(
                    f"{file}: [{title}] sets {name}, which is not of one clip; give it to "
                    "cageik batch, if it has it"
                )
        return {
            name: str(file.parent / value) if is_path(self._command, name) else value
            for name, value in chosen.items()
        }


def is_no_frame(command: click.Command, name: str) -> bool:
    """Whether what a parameter names is a file beside a clip: a rest pose may be a frame of it."""
    return name != "rest" and is_path(command, name)


def is_path(command: click.Command, name: str) -> bool:
    """Whether the values of a parameter are paths."""
    return any(
        param.name == name and isinstance(param.type, click.Path) for param in command.params
    )


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
