"""What a user names as an input, opened: a mesh, points or splats, of any file that holds them."""

import glob
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.choose_parts import drop_parts, select_parts
from cageik_cli.formats.base.files import decompress, describe_source, file_stem, hash_file
from cageik_cli.formats.base.hdf5 import HDF5_SUFFIXES
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.find_files import Source, sort_naturally
from cageik_cli.formats.open import load_mesh
from cageik_cli.formats.ply import Reader as PlyReader
from cageik_cli.formats.ply_points import (
    MOVED,
    PointFile,
    PointWriter,
    holds_splats,
    parse_points,
    read_splats,
)
from cageik_cli.formats.settings import SceneHints
from cageik_cli.formats.usd.library import USD_SUFFIXES
from cageik_cli.formats.write import PLACEHOLDER, Output, WriterFactory, names_parts
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import join_meshes, split_parts
from cageik_cli.geometry.points import PointCloud
from cageik_cli.method.points.oriented import Oriented, Splats
from cageik_cli.method.weights.binding import Binding
from cageik_cli.method.weights.settings import COORDINATES
from cageik_cli.store.binding_file import StoredBinding, is_binding, read_binding
from cageik_cli.store.result import StoredAnimation, is_animation, read_animation
from cageik_cli.util.errors import (
    FileAccessError,
    OutputError,
    SettingError,
    error_context,
    join_truncated,
)
from cageik_cli.util.files import read_input
from cageik_cli.util.messages import Hint, Note, say
from cageik_cli.util.progress import ProgressListener, note_all
from cageik_cli.util.text import to_unicode

Role = Literal["rest", "cage"]
"""What is wanted of a result or a binding, and what `FILE::rest` and `FILE::cage` name."""

POINT_SUFFIXES = (".ply", ".npz", ".pc2", ".mdd")
"""What points without faces can be written as."""

SPLAT_SUFFIXES = (".ply", *USD_SUFFIXES)


def holds_caged_model(path: Path) -> bool:
    """Return whether a file is a result, an edit or a binding; InputError if it cannot be read."""
    return path.suffix.lower() in HDF5_SUFFIXES and (is_binding(path) or is_animation(path))


def read_caged(path: Path) -> StoredAnimation | StoredBinding | None:
    """Read a result, an edit or a binding; None if it is another file."""
    if path.suffix.lower() not in HDF5_SUFFIXES:
        return None
    if is_binding(path):
        return read_binding(path)
    return read_animation(path) if is_animation(path) else None


def get_meshes(held: StoredAnimation | StoredBinding) -> tuple[TriMesh, TriMesh, SceneHints]:
    """Return the rest pose and the cage of a result or a binding, and their scene, if known."""
    if isinstance(held, StoredBinding):
        return held.binding.rest, held.binding.cage, SceneHints()
    return held.rest, held.cage, held.scene.space


def load_source(name: Path, role: Role = "rest", exclude: Sequence[str] = ()) -> LoadedMesh:
    """Read a mesh file, the first frame of a clip, or what a result or a binding holds.

    Parameters
    ----------
    name : Path
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
    source = Source.parse(name)
    file, member = source.file, source.member
    _check_one_file(file, role)
    held = read_caged(file) if file.is_file() else None
    if held is None:
        return load_mesh(source, exclude)
    if member not in (None, "rest", "cage"):
        raise SettingError(
            f"{file}: holds no mesh `{to_unicode(member)}`; choose `rest` or `cage`, as in "
            f"{file.name}::rest"
        )
    rest, cage, scene = get_meshes(held)
    part = member or role
    origin = {"name": to_unicode(f"{file.name}::{part}"), "sha256": hash_file(file).hex()}
    with error_context(source):
        mesh, _, notes = select_parts(rest if part == "rest" else cage, None, exclude)
    return LoadedMesh(mesh, origin, tuple(map(Note, notes)), name, scene)


def _check_one_file(path: Path, role: Role) -> None:
    """Refuse a pattern, and a folder in place of a cage: a clip is meant, which may be either."""
    if path.is_dir() and role == "cage":
        raise FileAccessError(
            f"{path}: is a folder, expected the file of a cage; "
            + say("give the folder of a clip as `frames=`, and the cage as `cage=`")
        )
    if glob.has_magic(str(path)) and not path.exists():
        found = sort_naturally(map(Path, glob.glob(str(path), recursive=True)))
        names = join_truncated(to_unicode(file.name) for file in found) or "no file"
        raise FileAccessError(
            f"{path}: is a pattern ({names}), expected one file; "
            + say("give the frames of a clip as `frames=`, and one file as ")
            + Hint(role)
        )


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


@dataclass(frozen=True, slots=True, eq=False)
class LoadedModel:
    """A model and where it came from.

    Attributes
    ----------
    mesh : LoadedMesh
        Its vertices; of points and splats a `PointCloud`.
    points : PointFile, optional
        The properties of points.
    splats : Splats, optional
        If the points are Gaussian splats.
    """

    mesh: LoadedMesh
    points: PointFile | None = None
    splats: Splats | None = None

    def choose_output(self, output: Output) -> Output:
        """Return the output with the format of points, where it names none."""
        if self.points is None:
            return output
        if names_parts(output.path):
            raise OutputError(
                f"{output.path}: {self.name} is {self.kind}, which has no parts; leave "
                f"{PLACEHOLDER} out of the name"
            )
        if not output.has_format:
            output = replace(output, file_format="ply")
        known = POINT_SUFFIXES if self.splats is None else SPLAT_SUFFIXES
        if self.splats is not None and output.recentre:
            raise SettingError(
                f"{self.name}: is {self.kind}, "
                + say("which `recentre=True` cannot move; leave it out")
            )
        if output.suffix not in known:
            raise OutputError(
                f"{output.path}: a `{output.suffix}` cannot hold {self.name}, which "
                f"is {self.kind}; write {', '.join(known)}"
            )
        return output

    def check_posed_output(self, path: Path) -> None:
        """Refuse a file of one pose that cannot hold points; raises OutputError."""
        if self.points is not None and path.suffix.lower() != ".ply":
            raise OutputError(
                f"{path}: a `{path.suffix}` cannot hold {self.name}, which is "
                f"{self.kind}; write a .ply"
            )

    @property
    def name(self) -> str:
        """What messages call it."""
        return self.mesh.source["name"]

    def find_oriented(self, binding: Binding, note: Callable[[Note], None]) -> Oriented | None:
        """Return what turns with its points; None if nothing does, or can.

        `note` takes why normals cannot.
        """
        normals = None if self.points is None else self.points.normals
        if normals is None and self.splats is None:
            return None
        coordinates = binding.settings.coordinates
        if self.splats is not None or COORDINATES[coordinates].field is not None:
            return Oriented(normals, self.splats)
        text = (
            "its normals keep their values: turning them needs gradients, which "
            f"{coordinates} weights do not have here; "
        )
        note(Note(text + say("use `coordinates=harmonic`")))
        return None

    @property
    def kind(self) -> str:
        """What it is, in words."""
        if self.points is None:
            return "a mesh"
        return "a cloud of points" if self.splats is None else "a file of Gaussian splats"

    @property
    def unit(self) -> str:
        """What it consists of, in words."""
        if self.points is None:
            return "vertices"
        return "points" if self.splats is None else "splats"

    def note(self, progress: ProgressListener) -> Callable[[Note], None]:
        """Return what takes notes on the model."""
        return lambda note: note_all(progress, [note], self.name)

    def make_rest_rows(self) -> NDArray[Any]:
        """Return rows of the points at rest, which frames are made from; of splats, whole ones."""
        assert self.points is not None
        rows = self.points.rows
        return rows if self.splats is not None else np.zeros(len(rows), MOVED)

    def choose_writer(self, output: Output) -> WriterFactory | None:
        """Return what makes the writer of the model; None for the usual one of the format."""
        if self.points is None or (self.splats is None and output.suffix != ".ply"):
            return None
        if output.suffix != ".ply":
            from cageik_cli.formats.usd.writer import UsdSplatWriter

            return partial(UsdSplatWriter, points=self.points)
        return partial(PointWriter, points=self.points)


def load_surface(path: Path, exclude: Sequence[str] = ()) -> LoadedModel:
    """Read a mesh; raises as `load_source`."""
    return LoadedModel(load_source(path, exclude=exclude))


def load_model(path: Path, exclude: Sequence[str] = ()) -> LoadedModel:
    """Read a mesh, points without faces (.ply), or Gaussian splats (.ply)."""
    source = Source.parse(path)
    if source.suffix not in PlyReader.suffixes or source.member or path.is_dir() or exclude:
        return LoadedModel(load_source(path, exclude=exclude))
    with error_context(path):
        data = read_input(path)
        points = parse_points(decompress(data, source.suffix))
    if points is None:
        return LoadedModel(load_source(path))
    with error_context(path):
        splats = read_splats(points) if holds_splats(points) else None
        cloud = PointCloud.from_points(points.positions)
        mesh = LoadedMesh(cloud, describe_source(path, data), tuple(map(Note, points.notes)), path)
        return LoadedModel(mesh, points, splats)


def load_models(paths: Sequence[Path], place: Callable[[LoadedModel], LoadedModel]) -> LoadedModel:
    """Read a model, or several meshes as the parts of one.

    `place` brings each into the unit and the up axis of all.

    Raises
    ------
    InputError
        When one of several is points or splats.
    """
    models = [place(load_model(path)) for path in paths]
    if len(models) == 1:
        return models[0]
    for path, model in zip(paths, models, strict=True):
        if model.points is not None:
            raise SettingError(
                f"{path}: is {model.kind}, which cannot be a part of a model; move it by itself"
            )
    parts, names = [], []
    for path, model in zip(paths, models, strict=True):
        own = split_parts(model.mesh.mesh)
        parts += own
        names += [part.name or to_unicode(file_stem(Source.parse(path).file)) for part in own]
    meshes, transforms = [part.mesh for part in parts], [part.transform for part in parts]
    loaded = [model.mesh for model in models]
    notes = tuple(note.at(one.source["name"]) for one in loaded for note in one.notes)
    joined = LoadedMesh(
        join_meshes(meshes, names, transforms),
        {"name": join_truncated(one.source["name"] for one in loaded)},
        notes,
    )
    return LoadedModel(joined)
