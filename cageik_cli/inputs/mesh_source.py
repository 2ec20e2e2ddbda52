"""The mesh that an option names: of any format that holds one, a result or a binding."""

import glob
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from cageik_cli.formats.base.choose_parts import drop_parts, select_parts
from cageik_cli.formats.base.files import hash_file
from cageik_cli.formats.base.hdf5 import HDF5_SUFFIXES
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.find_files import sort_naturally, split_member
from cageik_cli.formats.open import load_mesh
from cageik_cli.formats.settings import SceneHints
from cageik_cli.store.binding_file import is_binding, read_binding
from cageik_cli.store.result import is_animation, read_animation
from cageik_cli.util.errors import (
    FileAccessError,
    SettingError,
    error_context,
    join_truncated,
)
from cageik_cli.util.messages import Hint, Note, say
from cageik_cli.util.text import to_unicode

Role = Literal["rest", "cage"]
"""What is wanted of a result or a binding, and what `FILE::rest` and `FILE::cage` name."""


def holds_caged_model(path: Path) -> bool:
    """Return whether a file is a result, an edit or a binding; InputError if it cannot be read."""
    return path.suffix.lower() in HDF5_SUFFIXES and (is_binding(path) or is_animation(path))


def load_source(path: Path, role: Role = "rest", exclude: Sequence[str] = ()) -> LoadedMesh:
    """Read a mesh file, the first frame of a clip, or what a result or a binding holds.

    Parameters
    ----------
    path : Path
        A file, or `FILE::PATH` for a part of a file of several meshes. Of a result or a binding,
        `FILE::rest` is the rest pose and `FILE::cage` the cage.
    role : "rest" or "cage"
        Which of both is meant where neither is named.
    exclude : sequence of str
        Patterns of parts that are left out.

    Raises
    ------
    InputError
        Naming the file, when it is missing, damaged, or holds no mesh.
    """
    file, member = split_member(path)
    _check_one_file(file, role)
    if not file.is_file() or not holds_caged_model(file):
        return load_mesh(path, exclude)
    if member not in (None, "rest", "cage"):
        raise SettingError(
            f"{file}: holds no mesh `{to_unicode(member)}`; choose `rest` or `cage`, as in "
            f"{file.name}::rest"
        )
    found = _read_meshes(file)[member or role]
    with error_context(path):
        mesh, _, notes = select_parts(found.mesh, None, exclude)
    return replace(found, mesh=mesh, notes=tuple(map(Note, notes)), path=path)


def _check_one_file(path: Path, role: Role) -> None:
    """Refuse a pattern, and a folder in place of a cage: a clip is meant, which may be either."""
    if path.is_dir() and role == "cage":
        raise FileAccessError(
            f"{path}: is a folder, expected the file of a cage; "
            + say("give the folder of a clip as `frames=`, and the cage as `cage=`")
        )
    if glob.has_magic(str(path)) and not path.exists():
        found = sort_naturally(map(Path, glob.glob(str(path), recursive=True)))
        names = join_truncated((to_unicode(file.name) for file in found), 3) or "no file"
        raise FileAccessError(
            f"{path}: is a pattern ({names}), expected one file; "
            + say("give the frames of a clip as `frames=`, and one file as ")
            + Hint(role)
        )


def name_source(path: Path) -> str:
    """Return the name of a file without its folder, and what is read of it, as it is typed."""
    file, member = split_member(path)
    return file.name if member is None else f"{file.name}::{member}"


def load_rest(path: Path, exclude: Sequence[str] = ()) -> LoadedMesh:
    """Read the rest pose of a clip, of which patterns leave out parts, where it has them.

    Raises
    ------
    InputError
        As `load_source`, or when nothing is left.
    """
    loaded = load_source(path)
    with error_context(path):
        mesh, notes = drop_parts(loaded.mesh, exclude)
    return replace(loaded, mesh=mesh, notes=(*loaded.notes, *map(Note, notes)))


def _read_meshes(file: Path) -> dict[str, LoadedMesh]:
    """Read the rest pose and the cage of a result or a binding."""
    scene = SceneHints()
    if is_binding(file):
        binding = read_binding(file).binding
        rest, cage = binding.rest, binding.cage
    else:
        result = read_animation(file)
        rest, cage = result.rest, result.cage
        scene = result.scene.space
    digest = hash_file(file).hex()
    return {
        role: LoadedMesh(mesh, {"name": f"{file.name}::{role}", "sha256": digest}, scene=scene)
        for role, mesh in (("rest", rest), ("cage", cage))
    }
