"""A model and the cage that moves it, whatever holds them, and the frames that its cages give."""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from itertools import cycle
from pathlib import Path

import numpy as np

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.cages.transforms import Transform
from cageik_cli.coordinates.binding import Binding, reconstruct_frames
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.formats.base.hdf5 import HDF5_SUFFIXES
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.find_files import split_member
from cageik_cli.formats.scene_conversion import SceneConversion
from cageik_cli.formats.settings import Scene, SceneHints
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.solver.alignment import best_rotations
from cageik_cli.solver.fitting.record import FitRecord
from cageik_cli.store import result as result_file
from cageik_cli.store.binding_file import StoredBinding, is_binding, read_binding
from cageik_cli.store.result import Result, read_cages, read_result
from cageik_cli.util.arrays import Floats, Integers, fill_gaps
from cageik_cli.util.errors import SettingError, error_context
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.threads import OrderedMap
from cageik_cli.workflows.bind import WeightSettings, bind_cached, load_matching_binding
from cageik_cli.workflows.carry import carry_fit
from cageik_cli.workflows.common_scene import UNSTATED, CommonScene
from cageik_cli.workflows.mesh_source import holds_caged_model, load_source
from cageik_cli.workflows.model_file import LoadedModel, load_model, note_on
from cageik_cli.workflows.run_cage import build_cached, suggest_repair


@dataclass(frozen=True, slots=True, eq=False)
class CagedModel:
    """A model at rest and its cage: of a result, of a binding, or in files of their own.

    Attributes
    ----------
    path : Path
        The result, the binding file or the model.
    cage : LoadedMesh, optional
        None for a model in no cage yet.
    result : Result, optional
        With the cages of a clip.
    stored : StoredBinding, optional
        With the weights, of a binding file.
    source : CagedModel, optional
        The result or the binding that the cage is of, whose fit is carried to this model.
    offer : callable, optional
        Returns the options in place of a transform of the cage, see `CommonScene.offer`.
    """

    path: Path
    model: LoadedModel
    cage: LoadedMesh | None
    result: Result | None = None
    stored: StoredBinding | None = None
    source: "CagedModel | None" = None
    offer: Callable[[Transform | None], str] | None = None

    @staticmethod
    def open(
        path: Path,
        cage: Path | None = None,
        binding: Path | None = None,
        given_in: SceneHints = UNSTATED,
        load: Callable[[Path], LoadedModel] = load_model,
    ) -> "CagedModel":
        """Open a result or a binding; or a model, with its cage or a binding of it, if given.

        A cage may be that of a result or a binding, whose fit is then carried to the model. It is
        brought into the scene of the model; `given_in` is what it is in, if not what its file
        states.
        """
        if holds_caged_model(path):
            return CagedModel.read(path)
        model, loaded, offer = load(path), None, None
        source = None if cage is None else CagedModel._find_source(cage)
        if cage is not None:
            given = load_source(cage, "cage") if source is None else source.cage
            assert given is not None
            scene = CommonScene(model.mesh.scene, given_in)
            loaded, offer = scene.place(given), partial(scene.offer, source=given.scene)
        if binding is None:
            return CagedModel(path, model, loaded, source=source, offer=offer)
        stored = load_matching_binding(binding, model.mesh, loaded)
        return CagedModel(path, model, loaded, stored=stored, offer=offer)

    @staticmethod
    def _find_source(cage: Path) -> "CagedModel | None":
        """Read the result or the binding whose cage is named; None if it is another file."""
        file, member = split_member(cage)
        is_source = member in (None, "cage") and holds_caged_model(file)
        return CagedModel.read(file) if is_source else None

    @staticmethod
    def read(path: Path) -> "CagedModel":
        """Read a result or a binding."""
        if path.exists() and path.suffix.lower() in HDF5_SUFFIXES and is_binding(path):
            stored = read_binding(path)
            return _hold_meshes(path, stored.binding.rest, stored.binding.cage, stored=stored)
        return CagedModel.of_result(read_result(path))

    @staticmethod
    def of_result(result: Result) -> "CagedModel":
        """Return the model of a result that was read."""
        return _hold_meshes(result.path, result.rest, result.cage, result=result)

    @property
    def cage_name(self) -> str:
        """The name of the rest cage in messages."""
        return "the binding's cage" if self.result is None else "the result's cage"

    @property
    def scene(self) -> Scene:
        """The time and space of its clip; the usual ones if there is none."""
        return Scene() if self.result is None else self.result.scene

    @property
    def hints(self) -> SceneHints:
        """Unit and up axis, if they are known: of a result."""
        if self.result is None:
            return UNSTATED
        scene = self.result.scene
        return SceneHints(up_axis=scene.up_axis, metres_per_unit=scene.metres_per_unit)

    def require_result(self, need: str) -> Result:
        """Return the result.

        Raises
        ------
        SettingError
            Stating the need, when it is a binding.
        """
        if self.result is None:
            raise SettingError(f"{self.path}: is a binding, {need}")
        return self.result

    def read_bind_settings(self) -> BindSettings:
        """Return how the model was bound to the cage."""
        if self.result is None:
            assert self.stored is not None
            return self.stored.binding.settings
        with error_context(self.path):
            names = ("coordinates", "accuracy", "outside")
            return BindSettings(**{name: str(self.result.settings.get(name)) for name in names})

    def find_binding(self) -> Binding | None:
        """Read the weights; None if a result was written without, or there is a cage only."""
        if self.stored is not None:
            return self.stored.binding
        return None if self.result is None else result_file.read_binding(self.result)

    def read_binding(self, user: str) -> Binding:
        """Read the weights of a result or a binding.

        Raises
        ------
        SettingError
            When a result was written without; `user` is what needs them.
        """
        binding = self.find_binding()
        if binding is None:
            raise make_weights_error(self.path, user)
        return binding

    @property
    def fit(self) -> FitRecord | None:
        """How the weights were fitted; None if they were not."""
        if self.stored is not None:
            return self.stored.binding.fit
        return None if self.result is None else self.result.fit

    def read_reconstruction(self, user: str) -> "Reconstruction":
        """Read the mesh animation that the cages of a result give; raises as `read_binding`."""
        result, binding = self.require_result("which has no cages"), self.read_binding(user)
        rotations = result_file.read_rotations(result) if binding.has_offsets else None
        return Reconstruction(binding, CageFrames.from_result(result), rotations)

    def build_cage(
        self, settings: BuildSettings, cache: Path | None, progress: ProgressListener
    ) -> "CagedModel":
        """Return the model in a cage that is built around it, or taken from the cache."""
        with progress.stage("cage"), error_context(self.path):
            cage = build_cached(self.model.mesh.mesh, settings, cache, progress)
        return replace(self, cage=cage)

    def bind(self, weights: WeightSettings, progress: ProgressListener) -> Binding:
        """Return the weights of the binding; or bind model and cage, and note what changed."""
        if self.stored is not None:
            return self.stored.binding
        rest, cage = self.model.mesh, self.cage
        assert cage is not None
        with progress.stage("bind"), suggest_repair(cage, rest, self.offer):
            binding = bind_cached(rest, cage, weights, progress).binding
        note_on(progress, self.model.name, *rest.notes)
        note_on(progress, cage.source["name"], *binding.notes)
        return (
            binding if self.source is None else carry_fit(self.source, binding, weights, progress)
        )


def _hold_meshes(
    path: Path,
    rest: TriMesh,
    cage: TriMesh,
    *,
    result: Result | None = None,
    stored: StoredBinding | None = None,
) -> CagedModel:
    """Return what a file holds, whose meshes have no files of their own."""
    model = LoadedModel(LoadedMesh(rest, {"name": f"the rest pose of {path.name}"}))
    loaded = LoadedMesh(cage, {"name": f"the cage of {path.name}"})
    return CagedModel(path, model, loaded, result, stored)


def make_weights_error(path: Path, user: str) -> SettingError:
    """Make the error of a result that was written without weights; `user` is what needs them."""
    return SettingError(
        f"{path}: has no weights, which {user} needs; extract it again with them "
        "(`keep_weights=True`)"
    )


@dataclass(frozen=True, slots=True, eq=False)
class CageFrames:
    """The cages of an animation.

    Attributes
    ----------
    count : int
        Frames, those included whose cages fill a gap.
    known : (k,) int64
        Numbers of the other frames.
    read : callable
        Reads the cage of a frame, (n, 3), by its number.
    blocks : callable
        Yields all cages in order, in blocks (k, n, 3) of at most the given number of frames.
    """

    count: int
    known: Integers
    read: Callable[[int], Floats]
    blocks: Callable[[int], Iterator[Floats]]

    @staticmethod
    def from_result(result: Result) -> "CageFrames":
        """Return the cages of a result, whose gaps are filled."""
        count = len(result.frames)
        return CageFrames(
            count=count,
            known=np.setdiff1d(np.arange(count), result.gaps),
            read=lambda frame: next(read_cages(result, 1, frame))[0],
            blocks=lambda size: read_cages(result, size),
        )

    def convert(self, conversion: SceneConversion) -> "CageFrames":
        """Return the cages in another scene."""
        if not conversion:
            return self
        return CageFrames(
            count=self.count,
            known=self.known,
            read=lambda frame: conversion.apply(self.read(frame)),
            blocks=lambda size: map(conversion.apply, self.blocks(size)),
        )

    @staticmethod
    def from_clip(clip: MeshSequence, jobs: int) -> "CageFrames":
        """Return the frames of a clip of cages, which threads read in advance; gaps are filled."""
        known = np.setdiff1d(np.arange(len(clip)), list(clip.missing))

        def blocks(size: int) -> Iterator[Floats]:
            with closing(clip.blocks(size, jobs)) as read:
                for block in read:
                    block.raise_read_errors(ignore_missing=True)
                    fill_gaps(block.positions, block.start, known, clip.read_frame)
                    yield block.positions

        return CageFrames(len(clip), known, clip.read_frame, blocks)


@dataclass(frozen=True, slots=True, eq=False)
class RebuiltFrames:
    """Consecutive frames: their cages (k, n, 3), rotations (k, 3, 3), and meshes (k, m, 3)."""

    cages: Floats
    rotations: Floats
    meshes: Floats


class Reconstruction:
    """The mesh animation that cages give; a source of frames for a fit, without filled gaps.

    Parameters
    ----------
    rotations : (F, 3, 3) float64, optional
        Of the rest pose to each frame, for a binding that has offsets; else they are those of the
        cages.
    """

    def __init__(
        self, binding: Binding, cages: CageFrames, rotations: Floats | None = None
    ) -> None:
        self.binding, self.cages, self._rotations = binding, cages, rotations

    def __len__(self) -> int:
        return len(self.cages.known)

    def read_frame(self, index: int) -> Floats:
        """Return the mesh (m, 3) of a frame that fills no gap."""
        frame = int(self.cages.known[index])
        return np.asarray(self._rebuild(frame, self.cages.read(frame)[None]).meshes[0])

    def blocks(self, size: int) -> Iterator[RebuiltFrames]:
        """Yield all frames in order, in blocks of at most `size`."""
        start = 0
        for cages in self.cages.blocks(size):
            yield self._rebuild(start, cages)
            start += len(cages)

    def stream_meshes(self, size: int, jobs: int) -> Iterator[Floats]:
        """Yield the meshes (k, m, 3) of all frames in order, of at most `size` at once.

        A thread computes the next ones, with `jobs` threads, while these are used. An array is
        overwritten after the next one is taken: the caller uses one at a time.
        """
        shape = (min(size, self.cages.count), len(self.binding.rest.vertices), 3)
        buffers = cycle([np.empty(shape) for _ in range(2)])

        def rebuild(item: tuple[int, Floats, Floats]) -> Floats:
            start, cages, meshes = item
            rotations = self._turn(start, cages) if self.binding.has_offsets else None
            return reconstruct_frames(self.binding, cages, rotations, meshes[: len(cages)], jobs)

        with OrderedMap(rebuild, self._pair(size, buffers), 1, 1) as blocks:
            yield from blocks

    def _pair(self, size: int, buffers: Iterator[Floats]) -> Iterator[tuple[int, Floats, Floats]]:
        """Yield the number of the first frame of each block, its cages, and a buffer."""
        start = 0
        for cages in self.cages.blocks(size):
            yield start, cages, next(buffers)
            start += len(cages)

    def _rebuild(self, start: int, cages: Floats) -> RebuiltFrames:
        """Return the meshes of the cages of frames from `start` on."""
        rotations = self._turn(start, cages)
        return RebuiltFrames(cages, rotations, reconstruct_frames(self.binding, cages, rotations))

    def _turn(self, start: int, cages: Floats) -> Floats:
        """Return the rotations (k, 3, 3) of frames from `start` on."""
        if self._rotations is None:
            rest = self.binding.cage.vertices
            centred = cages - cages.mean(axis=1, keepdims=True)
            return best_rotations(centred, rest - rest.mean(axis=0), np.ones(len(rest)))
        return self._rotations[start : start + len(cages)]
