"""Find the files that arguments name: files, folders and globs, in natural order."""

import glob
import os
import shlex
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from natsort import natsort_keygen, ns

from cageik_cli.formats.base.file_numbers import FrameNames
from cageik_cli.formats.base.files import decompress, discover_plugins, file_suffix
from cageik_cli.formats.base.numbered_names import NumberedFiles, group_series
from cageik_cli.formats.base.readers import FrameFileReader, parse_mesh
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.util.errors import FileAccessError, SettingError, join_truncated
from cageik_cli.util.files import read_input
from cageik_cli.util.text import group_digits, to_unicode

MAX_COMPARED_MESHES = 16
"""Meshes of a folder that are compared, to see whether they are frames, at most."""

MAX_SAMPLED_MESHES = 5
"""Meshes of a series that are compared, evenly spread, at most: a damaged one is outvoted."""

MAX_NAMED_FILES = 3
"""Files beside frames that a note names; the others are counted."""

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


@dataclass(frozen=True, slots=True)
class Source:
    """What a user names as an input: FILE, or FILE::MEMBER for a part of what is in it.

    Attributes
    ----------
    file : Path
        A file, a folder or a glob.
    member : str, optional
        A mesh, a clip or a group; of a result `rest` or `cage`. It may have `::` of its own.
    suffix : str
        As of `file_suffix`.
    """

    file: Path
    member: str | None = None
    suffix: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "suffix", file_suffix(self.file))

    @staticmethod
    def parse(name: "str | Path | Source") -> "Source":
        """Return what a name means: a file that is spelt with `::` is one.

        Raises
        ------
        SettingError
            When the name is blank, or what stands between the file's `::` and the next, or the end.
        """
        if isinstance(name, Source):
            return name
        if not str(name).strip():
            raise SettingError("the name of an input is blank; name a file or a folder")
        if "::" not in str(name) or Path(name).exists():
            return Source(Path(name))
        words = str(name).split("::")
        stops = range(len(words) - 1, 0, -1)
        stop = next((k for k in stops if Path("::".join(words[:k])).exists()), 1)
        file = Path("::".join(words[:stop]))
        if not words[stop].strip():
            raise SettingError(
                f"{file}: given `::` without a name behind it; name what to read, as in "
                "FILE::NAME, or leave out `::`"
            )
        return Source(file, "::".join(words[stop:]))

    def __str__(self) -> str:
        """Return it as it is typed."""
        return f"{self.file}{self._behind}"

    @property
    def name(self) -> str:
        """As it is typed, without the folder."""
        return f"{self.file.name}{self._behind}"

    @property
    def _behind(self) -> str:
        return "" if self.member is None else f"::{self.member}"

    @property
    def is_mesh_file(self) -> bool:
        """Whether it is a file of a format of one mesh per file."""
        return self.suffix in mesh_suffixes() and self.file.is_file()


def parse_arguments(arguments: Sequence[str]) -> tuple[list[str], str | None]:
    """Return the files, folders and globs of arguments, and what the only one names behind `::`."""
    if len(arguments) != 1:
        return list(arguments), None
    source = Source.parse(arguments[0])
    return [arguments[0] if source.member is None else str(source.file)], source.member


def list_input_files(arguments: Sequence[str]) -> list[Path]:
    """List the files that `open_sequence` reads for the same arguments."""
    return expand_arguments(parse_arguments(arguments)[0], tuple(find_readers()))


def expand_arguments(arguments: Sequence[str], suffixes: tuple[str, ...]) -> list[Path]:
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
        if not matches:
            raise FileAccessError(f"{argument}: no file matches; {_describe_folder(path.parent)}")
        found = [path for match in matches for path in _expand_argument(match, suffixes)]
    else:
        raise _make_missing_error(path)
    if not found:
        below = suggest_series_below(path) if path.is_dir() else ""
        raise FileAccessError(
            f"{argument}: no frame found, expected files of formats {', '.join(suffixes)}"
            + (f"; {below}" if below else "")
        )
    return found


def _make_missing_error(path: Path) -> FileAccessError:
    """Make the error that a file is not there; a pattern of an output says what is typed here."""
    names = FrameNames.parse(path.name)
    if names is None:
        return FileAccessError(f"{path}: no such file or folder; check the path")
    place = path.with_name(f"{glob.escape(names.before)}*{glob.escape(names.after)}")
    return FileAccessError(
        f"{path}: no such file; numbers are written like this in names of outputs only, so name "
        f"the folder of the frames, {path.parent}, or a quoted glob, {_quote(place)}"
    )


def _describe_folder(folder: Path) -> str:
    """Say what is in a folder in which a pattern finds nothing, or in that above it."""
    if glob.has_magic(str(folder)):
        return "check the path"
    if not folder.is_dir():
        above = next(path for path in folder.parents if path.is_dir())
        return f"there is no folder {folder}; {_describe_folder(above)}"
    inside = sort_naturally(path for path in folder.iterdir() if path.name[0] != ".")
    names = join_truncated(to_unicode(path.name) for path in inside)
    place = "this folder" if folder == Path() else folder
    return f"{place} holds {names or 'no file'}"


def _choose_series(folder: Path, files: list[Path]) -> list[Path]:
    """Return the frames among the mesh and clip files of a folder.

    If some are a series of numbered meshes, the others are a cage, a rest pose, copies or props.
    """
    series = find_series(files)
    if not series:
        return files
    if len(series) > 1:  # cages of several sizes beside the frames, say
        series = [one for one in series if are_frames(one.paths)] or series
    kinds = {file_suffix(one.paths[0]) for one in series}
    if len(series) > 1 and len(kinds) == 1:
        series.sort(key=lambda one: one.name_around("*"))
        names = join_truncated(one.name_around("*") for one in series)
        choices = [
            f"{' '.join(_quote(folder / name) for name in one.list_globs(files))} "
            f"({len(one.paths)} meshes)"
            for one in series[:5]
        ]
        raise SettingError(
            f"{folder}: holds {len(series)} series of numbered meshes, {names}; choose one by a "
            f"quoted glob: {' or '.join(choices)}"
        )
    frames = {path for one in series for path in one.paths}
    # Frames of another format are not left out: that there are two is said.
    return [path for path in files if path in frames or any(one.has_name(path) for one in series)]


def _quote(path: Path) -> str:
    """Return a path or a glob as it is typed in a shell: no option, and in quotes where needed."""
    text = str(path)
    return shlex.quote(f"./{text}" if text.startswith("-") else text)


def find_series(files: Sequence[Path]) -> list[NumberedFiles]:
    """Return the series of several numbered meshes among files of a folder."""
    meshes = [path for path in files if file_suffix(path) in mesh_suffixes()]
    return [one for one in group_series(meshes) if len(one.paths) > 1]


def check_frames(arguments: Sequence[str], paths: tuple[Path, ...]) -> None:
    """Refuse meshes that are not frames of one another, such as a body and its clothes.

    Those of a folder are compared, each series of numbered files that are named, and those that
    are not numbered.

    Raises
    ------
    SettingError
        Saying what is there and what to name instead.
    """
    loose = set(paths)
    for folder in map(Path, arguments):
        inside = [path for path in paths if path.parent == folder] if folder.is_dir() else []
        loose -= set(inside)
        if inside and all(file_suffix(path) in mesh_suffixes() for path in inside):
            is_series = bool(find_series(inside))
            _check_meshes(str(folder), inside, "" if is_series else suggest_series_below(folder))
    named = [path for path in paths if path in loose]
    series = find_series(named)
    for one in series:
        what = "matches" if len(arguments) == 1 else "one of"
        _check_meshes(arguments[0], one.paths, "", what)
    if (
        len(named) > 1
        and not series
        and all(file_suffix(path) in mesh_suffixes() for path in named)
    ):
        _check_meshes(str(named[0]), named, "", what="one of")


def _check_meshes(place: str, meshes: Sequence[Path], below: str, what: str = "holds") -> None:
    """Refuse meshes that are no frames of one clip, or a folder in place of one `below` it."""
    is_series = bool(find_series(meshes))
    compared = _spread_frames(meshes) if is_series else meshes[:MAX_COMPARED_MESHES]
    counts = {path: _count_mesh(path) for path in compared}
    is_clip = _agree(counts.values(), allows_some=is_series)
    if is_clip and not below:
        return
    below = below or suggest_series_below(meshes[0].parent)
    others = (
        f"name one of them, as in {meshes[0]}, or export them as one file of several parts (.usdc, "
        ".abc, or .obj with objects)"
    )
    found = "a mesh" if len(meshes) == 1 else f"{len(meshes)} meshes"
    names = join_truncated(map(_describe_mesh, counts, counts.values()))
    raise SettingError(
        f"{place}: {what} {found}{'' if is_clip else ' that are no frames of one clip'} "
        f"({names}); {below or others}"
    )


def are_frames(series: Sequence[Path]) -> bool:
    """Return whether numbered meshes may be frames of one clip: most have the same counts.

    Files of about one size are not read.
    """
    sizes = [path.stat().st_size for path in series]
    if max(sizes) <= 1.1 * min(sizes):
        return True
    return _agree(map(_count_mesh, _spread_frames(series)), allows_some=True)


def _spread_frames(series: Sequence[Path]) -> list[Path]:
    """Return some meshes of a series, evenly spread, the first and the last among them."""
    count = min(len(series), MAX_SAMPLED_MESHES)
    return [series[k * (len(series) - 1) // max(count - 1, 1)] for k in range(count)]


def _agree(counts: Iterable[tuple[int | None, int] | None], allows_some: bool) -> bool:
    """Return whether all meshes have the same counts, or more than half; damaged ones agree."""
    found = Counter(counts)
    damaged = found.pop(None, 0)
    most = max(found.values(), default=0)
    return len(found) < 2 or (allows_some and 2 * (most + damaged) > found.total() + damaged)


def _count_mesh(path: Path) -> tuple[int | None, int] | None:
    """Return how many vertices and triangles a mesh file has; None if it cannot be read.

    Vertices that are welded are not counted: some may meet in one frame alone.
    """
    try:
        reader = find_mesh_readers()[file_suffix(path)]
        mesh = parse_mesh(reader, decompress(read_input(path), file_suffix(path)))
    except Exception:  # whatever is in the file: opening the frame says what is wrong
        return None
    return len(mesh.vertices) if reader.numbers_vertices else None, len(mesh.fans)


def _describe_mesh(path: Path, counts: tuple[int | None, int] | None) -> str:
    name = to_unicode(path.name)
    if counts is None:
        return name
    vertices, triangles = counts
    return f"{name} of " + (
        f"{group_digits(triangles)} triangles"
        if vertices is None
        else f"{group_digits(vertices)} vertices"
    )


def suggest_series_below(folder: Path) -> str:
    """Ask whether a folder in this one is meant, which has a series of meshes; nothing if none."""
    suffixes, found = mesh_suffixes(), []
    for inside in sort_naturally(path for path in folder.iterdir() if path.is_dir()):
        if inside.name.startswith(".") or not os.access(inside, os.R_OK | os.X_OK):
            continue
        series = find_series(_list_folder(inside, suffixes))
        count = max((len(one.paths) for one in series), default=0)
        if count:
            found.append(f"{to_unicode(inside)}, {count} meshes")
    return f"did you mean {' or '.join(found[:3])}?" if found else ""


def list_left_out(arguments: Sequence[str], paths: tuple[Path, ...]) -> list[str]:
    """Write a sentence on the files of folders that are no frames.

    And on files that are named: all are frames, but their numbers are lost if their names have
    other texts, as in `walk_*.obj` that matches copies, too.
    """
    suffixes, notes = tuple(find_readers()), []
    for folder in map(Path, arguments):
        if not folder.is_dir() or file_suffix(folder) in suffixes:
            continue
        left = [path for path in _list_folder(folder, suffixes) if path not in paths]
        if left:
            names = [path.name for path in sort_naturally(left)]
            notes.append(f"left out, as not numbered as the frames are: {count_names(names)}")
    if not any(Path(argument).is_dir() for argument in arguments):
        series = find_series(paths)
        others = len(paths) - sum(len(one.paths) for one in series)
        if series and (others or len(series) > 1):
            found = [f"{one.name_around('*')} ({len(one.paths)})" for one in series]
            found += [f"{others} more"] if others else []
            notes.append(
                f"the frames are named in several ways, {', '.join(found)}: they are in the order "
                "of their names, and have no numbers from these"
            )
    return notes


def count_names(names: Sequence[str]) -> str:
    """Join the first `MAX_NAMED_FILES` names, and count the others."""
    more = len(names) - MAX_NAMED_FILES
    named = ", ".join(map(to_unicode, names[:MAX_NAMED_FILES]))
    return f"{named} and {more} more" if more > 0 else named


def _list_folder(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    inside = (path for path in folder.iterdir() if not path.name.startswith("."))
    return [path for path in inside if file_suffix(path) in suffixes]


def _escape_existing_folders(pattern: Path) -> str:
    """Escape folders of a pattern that exist as they are spelt, with brackets for instance."""
    root = pattern.parents[-1]
    existing = next((folder for folder in pattern.parents if folder.exists()), root)
    return str(Path(glob.escape(str(existing))) / pattern.relative_to(existing))
