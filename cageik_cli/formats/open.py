"""Open clips: from files, folders and globs to a sequence of frames in natural order."""

import glob
import os
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from natsort import natsort_keygen, ns

from cageik_cli.formats.base.file_numbers import group_numbered_files
from cageik_cli.formats.base.files import decompress, describe_source, discover_plugins, file_suffix
from cageik_cli.formats.base.mesh_data import LoadedMesh, check_connectivity
from cageik_cli.formats.base.readers import FrameFileReader, parse_mesh
from cageik_cli.formats.base.sequence import ClipRequest, MeshSequence
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import (
    FileAccessError,
    FormatError,
    SettingError,
    error_context,
    join_truncated,
)
from cageik_cli.util.files import read_input
from cageik_cli.util.text import to_unicode

_UNSUPPORTED_REASONS = {
    ".bvh .c3d .asf .amc": "holds the motion of a skeleton, not a mesh; export the mesh that it "
    "moves, as OBJ frames",
    ".blend .fbx .ma .max .mb .hip .hipnc .hiplc .bgeo": "is a scene of another program; export "
    "the mesh from it as USD, Alembic or OBJ frames",
    ".glb .gltf": "is glTF, which cageik writes but does not read; export USD, Alembic or OBJ "
    "frames instead",
}
"""Why files that look like clips cannot be read, by their suffixes."""

_natural_key = natsort_keygen(key=str, alg=ns.PATH)


def open_sequence(
    arguments: list[str], settings: ClipSettings | None = None, rest: LoadedMesh | None = None
) -> MeshSequence:
    """Open the clip that `arguments` name: files, folders, globs, or one file that holds a clip.

    `FILE::CLIP` picks one of a file's clips. `rest` is the rest pose, for files that hold no faces.

    Raises
    ------
    InputError
        When nothing matches, formats are mixed, or the first frame cannot be read.
    """
    reader, request = _resolve_request(arguments, settings or ClipSettings(), rest)
    sequence = reader(request)
    sequence.notes = (*_list_left_out(arguments, request.paths), *sequence.notes)
    sequence.takes_missing = request.settings.missing
    return sequence


def list_members(path: Path) -> list[str]:
    """List the clips in a file that holds several; empty if it is a clip itself, or damaged."""
    try:
        return _find_readers()[file_suffix(path)].list_members(path)
    except Exception:  # whatever is in the file: opening it says what is wrong
        return []


def clip_suffixes() -> tuple[str, ...]:
    """Return the suffixes of the files that can be read."""
    return tuple(_find_readers())


def sort_naturally(paths: Iterable[Path]) -> list[Path]:
    """Sort paths by the numbers in them: 2 before 10; then by their text, as 01 before 1."""
    return sorted(paths, key=lambda path: (_natural_key(path), str(path)))


def describe_contents(arguments: list[str], settings: ClipSettings) -> list[tuple[str, str]]:
    """Describe files that are not a clip by themselves, in labelled lines; empty for a clip."""
    reader, request = _resolve_request(arguments, settings, None)
    return reader.describe_contents(request)


def _resolve_request(
    arguments: list[str], settings: ClipSettings, rest: LoadedMesh | None
) -> tuple[type[MeshSequence], ClipRequest]:
    readers_by_suffix = _find_readers()
    arguments, member = _split_member(arguments)
    paths = expand_arguments(arguments, tuple(readers_by_suffix))
    for path in paths:
        if file_suffix(path) not in readers_by_suffix:
            raise FileAccessError(f"{path}: {_explain_unsupported(file_suffix(path))}")
    kinds = sorted({file_suffix(path) for path in paths})
    if len(kinds) > 1:
        raise SettingError(
            f"{arguments[0]}: files of formats {', '.join(kinds)} are mixed; "
            "choose one format, for instance with a quoted glob"
        )
    reader = readers_by_suffix[kinds[0]]
    if member is not None and not reader.has_members:
        raise SettingError(
            f"{arguments[0]}::{member}: a `{kinds[0]}` file holds one clip; remove `::{member}`"
        )
    if settings.layout is not None and not reader.has_layout:
        raise SettingError(
            f"{arguments[0]}: the axes of `{kinds[0]}` files have a fixed order; remove "
            f"`layout={settings.layout}`"
        )
    return reader, ClipRequest(tuple(paths), member, rest, settings)


def _explain_unsupported(suffix: str) -> str:
    for suffixes, reason in _UNSUPPORTED_REASONS.items():
        if suffix in suffixes.split():
            return reason
    expected = ", ".join(_find_readers())
    return f"`{suffix}` is not a clip format that can be read, expected {expected}"


def list_input_files(arguments: list[str]) -> list[Path]:
    """List the files that `open_sequence` reads for the same arguments."""
    return expand_arguments(_split_member(arguments)[0], tuple(_find_readers()))


def expand_arguments(arguments: list[str], suffixes: tuple[str, ...]) -> list[Path]:
    """List every file that the arguments name, once, in natural order of the paths."""
    named = [path for argument in arguments for path in _expand_argument(argument, suffixes)]
    # A link to a frame is another frame (a hold); another spelling of its path is the same frame.
    once = {os.path.abspath(path): path for path in named}
    return sort_naturally(once.values())


def split_member(path: Path | str) -> tuple[Path, str | None]:
    """Return the file, and the text behind `::` in `FILE::TEXT`, or None."""
    if "::" not in str(path) or Path(path).exists():
        return Path(path), None
    file, member = str(path).rsplit("::", 1)
    return Path(file), member


def _split_member(arguments: list[str]) -> tuple[list[str], str | None]:
    """Return the arguments, and what the only one names behind `::`."""
    if len(arguments) != 1:
        return arguments, None
    file, member = split_member(arguments[0])
    return [arguments[0] if member is None else str(file)], member


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


def _list_left_out(arguments: list[str], paths: tuple[Path, ...]) -> list[str]:
    """Write a sentence on the files of folders that are no frames."""
    suffixes, notes = tuple(_find_readers()), []
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


def _find_readers() -> dict[str, type[MeshSequence]]:
    """Return the readers by the suffixes that they take."""
    return discover_plugins("Reader")


def open_clip_and_rest(
    frames: tuple[str, ...], settings: ClipSettings, rest_path: Path | None, rest_index: int
) -> tuple[MeshSequence, LoadedMesh]:
    """Open a clip and its rest pose: a mesh file of the same connectivity, or a frame of it."""
    rest = load_mesh(rest_path) if rest_path is not None else None
    sequence = open_sequence(list(frames), settings, rest)
    if rest is not None:
        with error_context(rest_path):
            fans = rest.mesh.fan_triangulated
            expected = sequence.first.fan_triangulated
            check_connectivity(len(fans.vertices), fans.faces, expected, "the first frame")
        # Polygons are cut as in the first frame, which may also know more of the surface.
        attributes = rest.mesh.attributes or sequence.first.attributes
        mesh = TriMesh(rest.mesh.vertices, sequence.first.faces, attributes)
        return sequence, replace(rest, mesh=mesh)
    return sequence, load_rest_frame(sequence, rest_index)


def load_rest_frame(sequence: MeshSequence, index: int) -> LoadedMesh:
    """Read a frame of a clip as its rest pose."""
    if not 0 <= index < len(sequence):
        raise SettingError(
            f"`rest_frame={index}`: the clip has {len(sequence)} frames, expected "
            f"0 to {len(sequence) - 1}"
        )
    positions = sequence.read_frame(index)
    missing = np.count_nonzero(np.isnan(positions[:, 0]))
    if missing:
        raise FormatError(
            f"{sequence.location(index)}: {missing} of {len(positions)} vertices of the rest pose "
            "are missing; take a complete frame by `rest_frame=`, or a mesh by `rest=`"
        )
    path = Path(sequence.location(index))
    is_mesh_file = file_suffix(path) in mesh_suffixes() and path.is_file()
    return LoadedMesh(
        sequence.first.move(positions),
        {"name": sequence.names[index]},
        path=path if is_mesh_file else None,
    )


def mesh_suffixes() -> tuple[str, ...]:
    """Return the suffixes of the mesh files that can be read."""
    return tuple(_find_mesh_readers())


def load_mesh(path: Path) -> LoadedMesh:
    """Read one mesh: a mesh file, or the first frame of a file that holds a clip.

    Polygons are cut into triangles, with a note. `FILE::PATH` picks what is read of a scene.

    Raises
    ------
    FileAccessError, FormatError
        Naming the file, when it is missing, not a mesh, or of an unknown format.
    """
    file, member = split_member(path)
    with error_context(file):
        if file.is_dir():
            raise FileAccessError("is a folder, expected a file; give a mesh in it")
        suffix, readers = file_suffix(file), _find_readers()
        if suffix not in readers:
            raise FileAccessError(
                f"`{suffix}` is not a mesh format that can be read, expected {', '.join(readers)}"
            )
    reader = _find_mesh_readers().get(suffix)
    if reader is None or member is not None:
        return _load_first_frame(path)
    with error_context(file):
        data = read_input(file)
        content = decompress(data, suffix)
        mesh = reader.read_attributes(content, parse_mesh(reader, content))
        mesh = reader.read_library(file, mesh)
        return LoadedMesh(mesh.make_mesh(), describe_source(file, data), mesh.notes, file)


def _load_first_frame(path: Path) -> LoadedMesh:
    """Read the first frame of a file that holds a clip, as a mesh."""
    reader, request = _resolve_request([str(path)], ClipSettings(selection=slice(0, 1)), None)
    if dict(reader.describe_contents(request)).get("holds"):
        raise FormatError(f"{path}: holds no faces, expected a mesh; give one in another format")
    clip = reader(request)
    return LoadedMesh(
        clip.first, clip.describe_source(), clip.notes, request.path, scene=clip.scene
    )


def _find_mesh_readers() -> dict[str, type[FrameFileReader]]:
    """Return the readers of files of one mesh, by suffix."""
    found = discover_plugins("Reader").items()
    return {suffix: kind for suffix, kind in found if issubclass(kind, FrameFileReader)}
