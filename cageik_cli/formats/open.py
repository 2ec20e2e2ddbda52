"""From what the user typed to a clip: files, folders and globs, in natural order."""

import glob
import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from natsort import natsort_keygen, ns

from cageik_cli.formats.base.file_names import kind_of, refuse_gaps
from cageik_cli.formats.base.registry import by_suffix
from cageik_cli.formats.base.sequence import (
    ClipRequest,
    ClipSettings,
    MeshSequence,
    refuse_other_connectivity,
)
from cageik_cli.formats.mesh_file import LoadedMesh, load_mesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import InputError, located

_SKELETAL = "holds the motion of a skeleton, no mesh; export the mesh it moves, as OBJ frames"
_SCENE = "is a scene of another program; export the mesh from there, as USD, Alembic or OBJ frames"
_GLTF = "is glTF, which is written here and not read; export USD, Alembic or OBJ frames instead"

_OTHERS = {
    **dict.fromkeys((".bvh", ".c3d", ".asf", ".amc"), _SKELETAL),
    **dict.fromkeys((".blend", ".fbx", ".ma", ".max", ".mb"), _SCENE),
    **dict.fromkeys((".glb", ".gltf"), _GLTF),
    **dict.fromkeys((".hip", ".hipnc", ".hiplc", ".bgeo"), _SCENE),
}
"""Why files that one might take for clips are none."""

_NATURAL = natsort_keygen(key=str, alg=ns.PATH)


def open_sequence(
    arguments: list[str], how: ClipSettings | None = None, rest: LoadedMesh | None = None
) -> MeshSequence:
    """Open the clip that `arguments` name: files, folders, globs, or one file that holds a clip.

    Parameters
    ----------
    arguments : list of str
        `FILE::CLIP` picks one of a file's clips.
    how : ClipSettings, optional
    rest : LoadedMesh, optional
        The rest pose, for files that hold no faces.

    Raises
    ------
    InputError
        When nothing matches, kinds are mixed, or the first frame cannot be read.
    """
    reader, request = _requested(arguments, how or ClipSettings(), rest)
    return reader(request)


def members_of(path: Path) -> list[str]:
    """Names of the clips in a file of several; none if the file is a clip itself, or unsound."""
    try:
        return _readers()[kind_of(path)].members(path)
    except InputError:
        return []  # whoever opens it is told


def clip_suffixes() -> tuple[str, ...]:
    """The kinds of files that are read."""
    return tuple(_readers())


def in_natural_order(paths: Iterable[Path]) -> list[Path]:
    """Paths as people count: 2 before 10. Those alike but for leading zeros, by their text."""
    return sorted(paths, key=lambda path: (_NATURAL(path), str(path)))


def outline(arguments: list[str], how: ClipSettings) -> list[tuple[str, str]]:
    """What files hold that are no clip by themselves, in labelled lines; none for a clip.

    Raises
    ------
    InputError
        As `open_sequence` does.
    """
    reader, request = _requested(arguments, how, None)
    return reader.outline(request)


def _requested(
    arguments: list[str], how: ClipSettings, rest: LoadedMesh | None
) -> tuple[type[MeshSequence], ClipRequest]:
    kinds_read = _readers()
    arguments, member = _parted(arguments)
    paths = frame_paths(arguments, tuple(kinds_read))
    for path in paths:
        if kind_of(path) in _OTHERS:
            raise InputError(f"{path}: {_OTHERS[kind_of(path)]}")
        if kind_of(path) not in kinds_read:
            raise InputError(
                f"{path}: `{kind_of(path)}` is not a kind of clip read here, expected "
                f"{', '.join(kinds_read)}"
            )
    kinds = sorted({kind_of(path) for path in paths})
    if len(kinds) > 1:
        raise InputError(
            f"{arguments[0]}: files of kinds {', '.join(kinds)} are mixed; "
            "name one kind, for instance with a quoted glob"
        )
    reader = kinds_read[kinds[0]]
    if member is not None and not reader.has_members:
        raise InputError(
            f"{arguments[0]}::{member}: a `{kinds[0]}` file holds one clip; leave `::{member}` out"
        )
    if how.layout is not None and not reader.has_layout:
        raise InputError(
            f"{arguments[0]}: the axes of `{kinds[0]}` files have one order; leave "
            f"--layout {how.layout} out"
        )
    if not how.allow_gaps:
        refuse_gaps(paths)
    return reader, ClipRequest(tuple(paths), member, rest, how)


def files_read(arguments: list[str]) -> list[Path]:
    """The files that `open_sequence` reads for the same arguments."""
    return frame_paths(_parted(arguments)[0], tuple(_readers()))


def frame_paths(arguments: list[str], suffixes: tuple[str, ...]) -> list[Path]:
    """Every file that the arguments name, once, in natural order of their paths."""
    named = [path for argument in arguments for path in _named_by(argument, suffixes)]
    # A link to a frame is a frame of its own (a hold); another spelling of its path is not.
    once = {os.path.abspath(path): path for path in named}
    return in_natural_order(once.values())


def _parted(arguments: list[str]) -> tuple[list[str], str | None]:
    """The arguments, and the clip that `FILE::CLIP` names in the file of the only one."""
    if len(arguments) == 1 and "::" in arguments[0] and not Path(arguments[0]).exists():
        file, member = arguments[0].rsplit("::", 1)
        return [file], member
    return arguments, None


def _named_by(argument: str, suffixes: tuple[str, ...]) -> list[Path]:
    path = Path(argument)
    if path.is_dir() and kind_of(path) not in suffixes:
        inside = [p for p in path.iterdir() if not p.name.startswith(".")]
        found = [p for p in inside if kind_of(p) in suffixes]
    elif path.exists():
        return [path]
    elif glob.has_magic(argument):
        matches = glob.glob(_with_literal_folders(path), recursive=True)
        found = [path for match in matches for path in _named_by(match, suffixes)]
    else:
        raise InputError(f"{argument}: no such file or folder; check the path")
    if not found:
        raise InputError(
            f"{argument}: no frame found, expected files of kinds {', '.join(suffixes)}"
        )
    return found


def _with_literal_folders(pattern: Path) -> str:
    """The pattern with folders that exist as they are spelt taken so, brackets and all."""
    root = pattern.parents[-1]
    existing = next((folder for folder in pattern.parents if folder.exists()), root)
    return str(Path(glob.escape(str(existing))) / pattern.relative_to(existing))


def _readers() -> dict[str, type[MeshSequence]]:
    """The readers by the suffixes they take."""
    return by_suffix("Reader")


def clip_and_rest(
    frames: tuple[str, ...], how: ClipSettings, path: Path | None, index: int
) -> tuple[MeshSequence, LoadedMesh]:
    """A clip and its rest pose: that of a file, of the clip's connectivity, or a frame of it."""
    rest = load_mesh(path) if path is not None else None
    sequence = open_sequence(list(frames), how, rest)
    if rest is not None:
        with located(path):
            count, faces = len(rest.fanned.vertices), rest.fanned.faces
            refuse_other_connectivity(count, faces, sequence.fanned, "the first frame")
        # Polygons are cut alike in all frames: as in the first.
        return sequence, replace(rest, mesh=TriMesh(rest.mesh.vertices, sequence.first.faces))
    if not 0 <= index < len(sequence):
        raise InputError(
            f"--rest-frame {index}: the clip has {len(sequence)} frames, expected "
            f"0 to {len(sequence) - 1}"
        )
    frame = TriMesh(sequence.frame(index), sequence.first.faces)
    return sequence, LoadedMesh(frame, frame, {"name": sequence.names[index]})
