"""Find the files that arguments name: files, folders and globs, in natural order."""

import glob
import os
import re
from collections.abc import Iterable
from pathlib import Path

from natsort import natsort_keygen, ns

from cageik_cli.formats.base.file_numbers import group_numbered_files
from cageik_cli.formats.base.files import discover_plugins, file_suffix
from cageik_cli.formats.base.readers import FrameFileReader
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.util.errors import FileAccessError, SettingError, join_truncated
from cageik_cli.util.text import to_unicode

_natural_key = natsort_keygen(key=str, alg=ns.PATH)


def find_readers() -> dict[str, type[MeshSequence]]:
    """Return the readers by the suffixes that they take."""
    return discover_plugins("Reader")


def find_mesh_readers() -> dict[str, type[FrameFileReader]]:
    """Return the readers of files of one mesh, by suffix."""
    found = discover_plugins("Reader").items()
    return {suffix: kind for suffix, kind in found if issubclass(kind, FrameFileReader)}


def clip_suffixes() -> tuple[str, ...]:
    """Return the suffixes of the files that can be read."""
    return tuple(find_readers())


def mesh_suffixes() -> tuple[str, ...]:
    """Return the suffixes of the mesh files that can be read."""
    return tuple(find_mesh_readers())


def sort_naturally(paths: Iterable[Path]) -> list[Path]:
    """Sort paths by the numbers in them: 2 before 10; then by their text, as 01 before 1."""
    return sorted(paths, key=lambda path: (_natural_key(path), str(path)))


def split_member(path: Path | str) -> tuple[Path, str | None]:
    """Return the file, and the text behind `::` in `FILE::TEXT`, which may have others, or None."""
    if "::" not in str(path) or Path(path).exists():
        return Path(path), None
    words = str(path).split("::")
    stops = range(len(words) - 1, 0, -1)
    stop = next((k for k in stops if Path("::".join(words[:k])).exists()), 1)
    return Path("::".join(words[:stop])), "::".join(words[stop:])


def split_only_member(arguments: list[str]) -> tuple[list[str], str | None]:
    """Return the arguments, and what the only one names behind `::`."""
    if len(arguments) != 1:
        return arguments, None
    file, member = split_member(arguments[0])
    return [arguments[0] if member is None else str(file)], member


def list_input_files(arguments: list[str]) -> list[Path]:
    """List the files that `open_sequence` reads for the same arguments."""
    return expand_arguments(split_only_member(arguments)[0], tuple(find_readers()))


def expand_arguments(arguments: list[str], suffixes: tuple[str, ...]) -> list[Path]:
    """List every file that the arguments name, once, in natural order of the paths."""
    named = [path for argument in arguments for path in _expand_argument(argument, suffixes)]
    # A link to a frame is another frame (a hold); another spelling of its path is the same frame.
    once = {os.path.abspath(path): path for path in named}
    return sort_naturally(once.values())


def _expand_argument(argument: str, suffixes: tuple[str, ...]) -> list[Path]:
    path = Path(argument)
    if path.is_dir() and file_suffix(path) not in suffixes:
        found = _choose_series(path, _list_folder(path, suffixes))
    elif path.exists():
        return [path]
    elif glob.has_magic(argument):
        matches = glob.glob(_escape_existing_folders(path), recursive=True)
        found = [path for match in matches for path in _expand_argument(match, suffixes)]
    else:
        raise FileAccessError(f"{argument}: no such file or folder; check the path")
    if not found:
        raise FileAccessError(
            f"{argument}: no frame found, expected files of formats {', '.join(suffixes)}"
        )
    return found


def _choose_series(folder: Path, files: list[Path]) -> list[Path]:
    """Return the frames among the mesh and clip files of a folder.

    If some are a series of numbered meshes, the others are a cage, a rest pose or props; those
    whose names begin as the series does, up to a number, are frames all the same.
    """
    meshes = [path for path in files if file_suffix(path) in mesh_suffixes()]
    groups = group_numbered_files(meshes).items()
    series = {stem.rpartition("#")[0]: group for stem, group in groups if len(group) > 1}
    if not series:
        return files
    begins = re.compile("|".join(map(re.escape, series)))
    kinds = {file_suffix(group[0]) for group in series.values()}
    if len(series) > 1 and len(kinds) == 1:
        names = join_truncated((f"{start}*" for start in sorted(series)), 5)
        example = folder / f"{min(series)}*{min(kinds)}"
        raise SettingError(
            f"{folder}: holds {len(series)} series of numbered meshes, {names}; choose one by a "
            f"quoted glob, such as '{example}'"
        )
    return [path for path in files if _continues_with_number(path.name, begins)]


def _continues_with_number(name: str, begins: re.Pattern[str]) -> bool:
    match = begins.match(name)
    return match is not None and re.match(r"-?\d", name[match.end() :]) is not None


def list_left_out(arguments: list[str], paths: tuple[Path, ...]) -> list[str]:
    """Write a sentence on the files of folders that are no frames."""
    suffixes, notes = tuple(find_readers()), []
    for folder in map(Path, arguments):
        if not folder.is_dir() or file_suffix(folder) in suffixes:
            continue
        left = [path for path in _list_folder(folder, suffixes) if path not in paths]
        if left:
            names = join_truncated(to_unicode(path.name) for path in sort_naturally(left))
            notes.append(f"left out, as not numbered as the frames are: {names}")
    return notes


def _list_folder(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    inside = (path for path in folder.iterdir() if not path.name.startswith("."))
    return [path for path in inside if file_suffix(path) in suffixes]


def _escape_existing_folders(pattern: Path) -> str:
    """Escape folders of a pattern that exist as they are spelt, with brackets for instance."""
    root = pattern.parents[-1]
    existing = next((folder for folder in pattern.parents if folder.exists()), root)
    return str(Path(glob.escape(str(existing))) / pattern.relative_to(existing))
