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

from cageik_cli.cli.config import (
    CLIPS_TABLE,
    check_tables,
    list_commands,
    parse_options,
    read_tables,
)
from cageik_cli.cli.extract import extract_command, make_extract_settings
from cageik_cli.cli.options.limits import pop_limits
from cageik_cli.util.errors import CageikError, InputError

CONFIG_NAME = "cageik.toml"
EXTRACT_COMMAND = "extract"


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
        self, command: click.Command, commands: Sequence[str], batch_options: Sequence[str]
    ) -> None:
        self._command = command
        self._commands = commands
        self._batch_options = batch_options
        self._tables_by_file: dict[Path, dict[str, Any]] = {}

    def collect_options(self, folder: Path, path: Path) -> dict[str, Any]:
        """What the clip at `path`, in the folder `folder`, is given, by parameters' names.

        Raises
        ------
        click.BadParameter
            Naming the file that is at fault.
        """
        options: dict[str, Any] = {}
        for file in reversed(list(self._config_files(folder))):
            name = path.relative_to(file.parent).as_posix()
            for title, table in self._read_clip_tables(file):
                pattern = title.removeprefix(f"{CLIPS_TABLE}.")
                if title == EXTRACT_COMMAND or fnmatch(name, pattern):
                    options |= self._resolve_options(file, title, table)
        return options

    def find_auxiliary_files(self, folder: Path) -> set[Path]:
        """Every file that tables of this folder, or of those above it, name.

        A file that cannot be read names none; its clips are told.
        """
        files: set[Path] = set()
        for file in self._config_files(folder):
            try:
                tables = [
                    self._resolve_options(file, *table) for table in self._read_clip_tables(file)
                ]
            except click.UsageError:
                continue
            files.update(
                Path(value).resolve()
                for table in tables
                for name, value in table.items()
                if is_auxiliary_path(self._command, name)
            )
        return files

    def _config_files(self, folder: Path) -> Iterator[Path]:
        """Those that count in a folder, its own first."""
        place = folder.absolute()
        return (
            above / CONFIG_NAME
            for above in (place, *place.parents)
            if (above / CONFIG_NAME).is_file()
        )

    def _read_clip_tables(self, file: Path) -> Iterator[tuple[str, Any]]:
        if file not in self._tables_by_file:
            tables = read_tables(file)
            check_tables(file, tables, self._commands)
            self._tables_by_file[file] = tables
        tables = self._tables_by_file[file]
        if EXTRACT_COMMAND in tables:
            yield EXTRACT_COMMAND, tables[EXTRACT_COMMAND]
        yield from (
            (f"{CLIPS_TABLE}.{pattern}", table)
            for pattern, table in tables.get(CLIPS_TABLE, {}).items()
        )

    def _resolve_options(self, file: Path, title: str, table: Any) -> dict[str, Any]:
        """A table's options, paths made absolute."""
        options = parse_options(file, title, table, self._command)
        for name in options:
            if name in self._batch_options:
                raise click.BadParameter(
                    f"{file}: [{title}] sets {name}, which is not of one clip; give it to "
                    "cageik batch, if it has it"
                )
        return {
            name: str(file.parent / value) if is_path_option(self._command, name) else value
            for name, value in options.items()
        }


def is_auxiliary_path(command: click.Command, name: str) -> bool:
    """Whether what a parameter names is a file beside a clip: a rest pose may be a frame of it."""
    return name != "rest" and is_path_option(command, name)


def is_path_option(command: click.Command, name: str) -> bool:
    """Whether the values of a parameter are paths."""
    return any(
        param.name == name and isinstance(param.type, click.Path) for param in command.params
    )


BATCH_OPTIONS = (
    "output",
    "exports",
    "overwrite",
    "resume",
    "timings",
    "jobs",
    "quiet",
    "config",
    "verbose",
)
"""Options of `extract` that a batch has of its own, or that are not for one clip of many."""

PER_CLIP_OPTIONS = [
    option
    for option in extract_command.params
    if isinstance(option, click.Option) and option.name not in BATCH_OPTIONS
]


def plan_batch(folders: tuple[Path, ...], output: Path, options: dict[str, Any]) -> Any:
    """What is to be done: a job a clip that is found.

    Raises
    ------
    click.UsageError
        When clips would be looked for among the results.
    InputError
        When there are none, or none can be begun for the same reason.
    """
    from cageik_cli.report.baseline import read_baseline
    from cageik_cli.report.overview import ClipEntry
    from cageik_cli.util.outputs import check_no_overlap
    from cageik_cli.util.text import to_unicode
    from cageik_cli.workflows.batch.discover import DiscoveryFilter, discover_clips, walk_folders
    from cageik_cli.workflows.batch.jobs import CLIPS_FOLDER, ClipJob
    from cageik_cli.workflows.batch.run import (
        REPORT_FILES,
        WEIGHT_CACHE_FOLDER,
        BatchPlan,
        check_is_result,
    )

    load_baseline = cache(read_baseline)
    tables = ClipTables(extract_command, list_commands(click.get_current_context()), BATCH_OPTIONS)
    command_line, config_file = _split_options()
    files = [
        value
        for name, value in (config_file | command_line).items()
        if is_auxiliary_path(extract_command, name)
    ]
    auxiliary_files = {Path(file).resolve() for file in files if file is not None}
    roots = [_make_absolute(folder) for folder in folders]
    for root in roots:
        _check_not_results(root, output)
        auxiliary_files.update(
            *(tables.find_auxiliary_files(folder) for folder in walk_folders(root, output))
        )
    check_no_overlap([output / name for name in REPORT_FILES], list(auxiliary_files))
    found = discover_clips(
        roots, DiscoveryFilter(frozenset(auxiliary_files), output, options["exclude"])
    )
    jobs, rejected = [], []
    for clip in found:
        try:
            given = config_file | tables.collect_options(clip.folder, clip.path)
            settings, limits = _make_clip_settings(clip, given, command_line, load_baseline)
            place = output / CLIPS_FOLDER / f"{clip.name}.h5"
            if not options["overwrite"]:
                check_is_result(place)
        except (click.UsageError, CageikError) as error:
            rejected.append(ClipEntry(clip.name, fault=to_unicode(_describe_fault(error))))
            continue
        settings = replace(
            settings,
            output=place,
            cache=settings.cache or output / WEIGHT_CACHE_FOLDER,
            resume=options["resume"] or not options["overwrite"],
            overwrite=options["resume"] or options["overwrite"],
        )
        jobs.append(ClipJob(clip.name, settings, limits, options["pages"]))
    faults = {entry.fault for entry in rejected}
    if not jobs and len(faults) == 1:
        raise InputError(f"none of {len(found)} clips can be begun: {faults.pop()}")
    order = tuple(clip.name for clip in found)
    return BatchPlan(output, tuple(jobs), tuple(rejected), order)


def _check_not_results(folder: Path, output: Path) -> None:
    """Refuse to look for clips where the results are to be."""
    from cageik_cli.workflows.batch.jobs import CLIPS_FOLDER

    place, results = folder.resolve(), output.resolve() / CLIPS_FOLDER
    if place == output.resolve() or results in (place, *place.parents):
        raise click.UsageError(f"{folder}: is where the results would be; name another with -o")


def _split_options() -> tuple[dict[str, Any], dict[str, Any]]:
    """The options for all clips: those of the command line, and those of its file of options."""
    context = click.get_current_context()
    values = {
        name: str(value.absolute()) if isinstance(value, Path) else value
        for name, value in context.params.items()
        if name in {option.name for option in PER_CLIP_OPTIONS}
    }
    sources = {name: context.get_parameter_source(name) for name in values}
    command_line, config_file = (
        {name: value for name, value in values.items() if sources[name] is source}
        for source in (ParameterSource.COMMANDLINE, ParameterSource.DEFAULT_MAP)
    )
    return command_line, config_file


def _make_absolute(folder: Path) -> Path:
    """A folder's absolute path, whose parents are the folders above it."""
    return folder.resolve() if ".." in folder.parts else folder.absolute()


def _make_clip_settings(
    clip: Any, given: dict[str, Any], command_line: dict[str, Any], load_baseline: Any
) -> Any:
    """What `cageik extract` would make of the clip, options of files, and those that are typed."""
    given = given | command_line
    if given.get("cage") is None and given.get("binding") is None:
        raise click.UsageError(
            f"no cage is named for it; give --cage, or name one in a {CONFIG_NAME} in its "
            f"folder or above"
        )
    parent = click.get_current_context().parent
    with extract_command.make_context(
        "extract", list(clip.frames), parent=parent, default_map=given
    ) as context:
        for name in command_line:
            context.set_parameter_source(name, ParameterSource.COMMANDLINE)
        options = dict(context.params)
        for name in BATCH_OPTIONS:
            options.pop(name, None)
        limits = pop_limits(options, load_baseline).match_by_name()
        return make_extract_settings(options | {"output": Path()}), limits


def _describe_fault(error: click.UsageError | CageikError) -> str:
    """Why a clip cannot be begun; values of the command line have been checked by then."""
    if isinstance(error, click.BadParameter) and error.param is not None:
        option = max(error.param.opts, key=len)
        return f"{option} of a {CONFIG_NAME} in its folder or above: {error.message.rstrip('.')}"
    return error.message if isinstance(error, click.UsageError) else str(error)
