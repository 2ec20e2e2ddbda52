"""From what the user typed to a clip: files, folders and globs, in natural order."""

import glob
import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from natsort import natsort_keygen, ns

from cageik_cli.formats.base.file_names import check_no_gaps, file_suffix
from cageik_cli.formats.base.registry import discover_plugins
from cageik_cli.formats.base.sequence import (
    ClipRequest,
    ClipSettings,
    MeshSequence,
    check_connectivity,
)
from cageik_cli.formats.mesh_file import LoadedMesh, load_mesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import FileAccessError, InputError, SettingError, error_context

_SKELETON_REASON = (
    "holds the motion of a skeleton, no mesh; export the mesh it moves, as OBJ frames"
)
_SCENE_REASON = (
    "is a scene of another program; export the mesh from there, as USD, Alembic or OBJ frames"
)
_GLTF_REASON = (
    "is glTF, which is written here and not read; export USD, Alembic or OBJ frames instead"
)

_UNSUPPORTED_REASONS = {
    **dict.fromkeys((".bvh", ".c3d", ".asf", ".amc"), _SKELETON_REASON),
    **dict.fromkeys((".blend", ".fbx", ".ma", ".max", ".mb"), _SCENE_REASON),
    **dict.fromkeys((".glb", ".gltf"), _GLTF_REASON),
    **dict.fromkeys((".hip", ".hipnc", ".hiplc", ".bgeo"), _SCENE_REASON),
}
"""Why files that one might take for clips are none."""

_natural_key = natsort_keygen(key=str, alg=ns.PATH)


def open_sequence(
    arguments: list[str], settings: ClipSettings | None = None, rest: LoadedMesh | None = None
) -> MeshSequence:
    """Open the clip that `arguments` name: files, folders, globs, or one file that holds a clip.

    Parameters
    ----------
    arguments : list of str
        `FILE::CLIP` picks one of a file's clips.
    settings : ClipSettings, optional
    rest : LoadedMesh, optional
        The rest pose, for files that hold no faces.

    Raises
    ------
    InputError
        When nothing matches, kinds are mixed, or the first frame cannot be read.
    """
    reader, request = _resolve_request(arguments, settings or ClipSettings(), rest)
    return reader(request)


def list_members(path: Path) -> list[str]:
    """Names of the clips in a file of several; none if the file is a clip itself, or unsound."""
    try:
        return _find_readers()[file_suffix(path)].list_members(path)
    except InputError:
        return []  # whoever opens it is told


def clip_suffixes() -> tuple[str, ...]:
    """The kinds of files that are read."""
    return tuple(_find_readers())


def sort_naturally(paths: Iterable[Path]) -> list[Path]:
    """Paths as people count: 2 before 10. Those alike but for leading zeros, by their text."""
    return sorted(paths, key=lambda path: (_natural_key(path), str(path)))


def describe_contents(arguments: list[str], settings: ClipSettings) -> list[tuple[str, str]]:
    """What files hold that are no clip by themselves, in labelled lines; none for a clip.

    Raises
    ------
    InputError
        As `open_sequence` does.
    """
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
            f"{arguments[0]}: files of kinds {', '.join(kinds)} are mixed; "
            "name one kind, for instance with a quoted glob"
        )
    reader = readers_by_suffix[kinds[0]]
    if member is not None and not reader.has_members:
        raise SettingError(
            f"{arguments[0]}::{member}: a `{kinds[0]}` file holds one clip; leave `::{member}` out"
        )
    if settings.layout is not None and not reader.has_layout:
        raise SettingError(
            f"{arguments[0]}: the axes of `{kinds[0]}` files have one order; leave "
            f"--layout {settings.layout} out"
        )
    if not settings.allow_gaps:
        check_no_gaps(paths)
    return reader, ClipRequest(tuple(paths), member, rest, settings)


def _explain_unsupported(suffix: str) -> str:
    expected = ", ".join(_find_readers())
    return _UNSUPPORTED_REASONS.get(
        suffix, f"`{suffix}` is not a clip format that can be read, expected {expected}"
    )


def list_input_files(arguments: list[str]) -> list[Path]:
    """The files that `open_sequence` reads for the same arguments."""
    return expand_arguments(_split_member(arguments)[0], tuple(_find_readers()))


def expand_arguments(arguments: list[str], suffixes: tuple[str, ...]) -> list[Path]:
    """Every file that the arguments name, once, in natural order of their paths."""
    named = [path for argument in arguments for path in _expand_argument(argument, suffixes)]
    # A link to a frame is a frame of its own (a hold); another spelling of its path is not.
    once = {os.path.abspath(path): path for path in named}
    return sort_naturally(once.values())


def _split_member(arguments: list[str]) -> tuple[list[str], str | None]:
    """The arguments, and the clip that `FILE::CLIP` names in the file of the only one."""
    if len(arguments) == 1 and "::" in arguments[0] and not Path(arguments[0]).exists():
        file, member = arguments[0].rsplit("::", 1)
        return [file], member
    return arguments, None


def _expand_argument(argument: str, suffixes: tuple[str, ...]) -> list[Path]:
    path = Path(argument)
    if path.is_dir() and file_suffix(path) not in suffixes:
        inside = [p for p in path.iterdir() if not p.name.startswith(".")]
        found = [p for p in inside if file_suffix(p) in suffixes]
    elif path.exists():
        return [path]
    elif glob.has_magic(argument):
        matches = glob.glob(_escape_existing_folders(path), recursive=True)
        found = [path for match in matches for path in _expand_argument(match, suffixes)]
    else:
        raise FileAccessError(f"{argument}: no such file or folder; check the path")
    if not found:
        raise FileAccessError(
            f"{argument}: no frame found, expected files of kinds {', '.join(suffixes)}"
        )
    return found


def _escape_existing_folders(pattern: Path) -> str:
    """The pattern with folders that exist as they are spelt taken so, brackets and all."""
    root = pattern.parents[-1]
    existing = next((folder for folder in pattern.parents if folder.exists()), root)
    return str(Path(glob.escape(str(existing))) / pattern.relative_to(existing))


def _find_readers() -> dict[str, type[MeshSequence]]:
    """The readers by the suffixes they take."""
    return discover_plugins("Reader")


def open_clip_and_rest(
    frames: tuple[str, ...], settings: ClipSettings, rest_path: Path | None, rest_index: int
) -> tuple[MeshSequence, LoadedMesh]:
    """A clip and its rest pose: that of a file, of the clip's connectivity, or a frame of it."""
    rest = load_mesh(rest_path) if rest_path is not None else None
    sequence = open_sequence(list(frames), settings, rest)
    if rest is not None:
        with error_context(rest_path):
            count, faces = len(rest.fan_triangulated.vertices), rest.fan_triangulated.faces
            check_connectivity(count, faces, sequence.fan_triangulated, "the first frame")
        # Polygons are cut alike in all frames: as in the first.
        return sequence, replace(rest, mesh=TriMesh(rest.mesh.vertices, sequence.first.faces))
    if not 0 <= rest_index < len(sequence):
        raise SettingError(
            f"--rest-frame {rest_index}: the clip has {len(sequence)} frames, expected "
            f"0 to {len(sequence) - 1}"
        )
    frame = TriMesh(sequence.read_frame(rest_index), sequence.first.faces)
    return sequence, LoadedMesh(frame, frame, {"name": sequence.names[rest_index]})
