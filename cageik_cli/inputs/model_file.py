"""A model that is moved: a mesh, points, or Gaussian splats."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.fit.transferred import TransferredChange
from cageik_cli.formats.base.files import decompress, describe_source, file_stem, file_suffix
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.find_files import split_member
from cageik_cli.formats.ply import Reader as PlyReader
from cageik_cli.formats.ply_points import (
    MOVED,
    PointFile,
    PointWriter,
    holds_splats,
    parse_points,
    place_normals,
    place_positions,
    place_splats,
    read_splats,
)
from cageik_cli.formats.usd.library import USD_SUFFIXES
from cageik_cli.formats.write import PLACEHOLDER, Output, WriterFactory, names_parts
from cageik_cli.geometry.parts import join_meshes, split_parts
from cageik_cli.geometry.points import PointCloud
from cageik_cli.inputs.mesh_source import load_source
from cageik_cli.method.points.motion import PointMotion
from cageik_cli.method.points.oriented import Oriented, Splats
from cageik_cli.method.weights.binding import FRAMES_PER_PRODUCT, Binding, Poses
from cageik_cli.method.weights.settings import COORDINATES
from cageik_cli.util.errors import OutputError, SettingError, error_context, join_truncated
from cageik_cli.util.files import read_input
from cageik_cli.util.messages import Note, say
from cageik_cli.util.progress import ProgressListener, note_all
from cageik_cli.util.text import to_unicode
from cageik_cli.util.threads import OrderedMap

if TYPE_CHECKING:
    from cageik_cli.inputs.reconstruction import CageFrames

POINT_SUFFIXES = (".ply", ".npz", ".pc2", ".mdd")
"""What points without faces can be written as."""

SPLAT_SUFFIXES = (".ply", *USD_SUFFIXES)


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
    suffix = file_suffix(path)
    if suffix not in PlyReader.suffixes or path.is_dir():
        return load_surface(path, exclude)
    with error_context(path):
        data = read_input(path)
        points = parse_points(decompress(data, suffix))
    if points is None or exclude:
        return load_surface(path, exclude)
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
        names += [part.name or to_unicode(file_stem(split_member(path)[0])) for part in own]
    meshes, transforms = [part.mesh for part in parts], [part.transform for part in parts]
    loaded = [model.mesh for model in models]
    notes = tuple(note.at(one.source["name"]) for one in loaded for note in one.notes)
    joined = LoadedMesh(
        join_meshes(meshes, names, transforms),
        {"name": join_truncated(one.source["name"] for one in loaded)},
        notes,
    )
    return LoadedModel(joined)


class PointReconstruction:
    """The frames of points that cages give, with their normals or as splats, as rows.

    Attributes
    ----------
    faults : Counter
        How often the points that were moved are where space has lost its shape; see
        `count_map_faults`.
    """

    def __init__(self, motion: PointMotion, jobs: int) -> None:
        self.faults = Counter[str]()
        self._motion, self._jobs = motion, jobs

    @staticmethod
    def prepare(
        binding: Binding,
        oriented: Oriented,
        *,
        memory: int,
        jobs: int,
        progress: ProgressListener,
        transferred: TransferredChange | None = None,
    ) -> "PointReconstruction":
        """Compute the gradients of the weights of points; raises as `PointMotion`.

        `transferred` is what was added to the weights from the fit of another model.
        """
        add = None if transferred is None else transferred.add_gradients_to
        with progress.stage("gradients"):
            room = max(0, memory - binding.weights.nbytes)
            motion = PointMotion(binding, oriented, room, jobs, progress.update, add)
            return PointReconstruction(motion, jobs)

    def stream_rows(
        self,
        rest: NDArray[Any],
        cages: "CageFrames",
        note: Callable[[Note], None],
    ) -> Iterator[NDArray[Any]]:
        """Yield the rows (k, m) of all frames in order; they are overwritten by the next.

        At rest, they are `rest` (m,). At the end, `note` takes what is wrong, one sentence each.
        """
        size = min(FRAMES_PER_PRODUCT, cages.count)
        # The next frames are computed while these are written.
        held = cycle([np.repeat(rest[None], size, axis=0) for _ in range(2)])

        def fill(item: tuple[NDArray[Any], Poses]) -> NDArray[Any]:
            rows, poses = item[0][: len(item[1])], item[1]
            self.fill_rows(rows, poses)
            return rows

        with OrderedMap(fill, zip(held, cages.poses(size), strict=False), 1, 1) as blocks:
            yield from blocks
        self.note_faults(len(rest) * cages.count, note)

    def fill_rows(self, rows: NDArray[Any], poses: Poses) -> None:
        """Fill the rows (k, m) of the frames of poses, block by block in threads."""
        move = partial(_move_block, self._motion, rows, poses)
        with OrderedMap(move, self._motion.blocks, self._jobs, 2 * self._jobs) as blocks:
            for found in blocks:
                self.faults += found

    def note_faults(self, count: int, note: Callable[[Note], None]) -> None:
        """Note how many of `count` moved points are where space has lost its shape."""
        parts, mirrored = "points", "turned inside out"
        if self._motion.moves_splats:
            parts = "splats"
            mirrored += "; their colours are turned by the nearest rotation"
        for number, what in (
            (self.faults["mirrored"], mirrored),
            (self.faults["flat"], "flattened to a sheet, a line or a point"),
        ):
            if number:
                text = f"{number} of {count} moved {parts} are {what}: the cage folds over there"
                note(Note(text, "warning"))


def _move_block(
    motion: PointMotion, rows: NDArray[Any], poses: Poses, chosen: slice
) -> Counter[str]:
    places, oriented, faults = motion.move(chosen, poses)
    for row, place, turned in zip(rows, places, oriented, strict=True):
        part = row[chosen]
        place_positions(part, place.T)
        if turned.normals is not None:
            place_normals(part, turned.normals)
        if turned.splats is not None:
            place_splats(part, turned.splats)
    return faults
