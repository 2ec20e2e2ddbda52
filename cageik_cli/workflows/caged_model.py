"""A model and the cage that moves it, whatever holds them."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.coordinates.binding import Binding
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.fit.settings import FitRecord
from cageik_cli.formats.base.hdf5 import HDF5_SUFFIXES
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.find_files import split_member
from cageik_cli.formats.scene_conversion import SceneConversion
from cageik_cli.formats.settings import Scene, SceneHints
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.store import result as result_file
from cageik_cli.store.binding_file import StoredBinding, is_binding, read_binding
from cageik_cli.store.result import Result, read_result
from cageik_cli.util.errors import SettingError, error_context, join_truncated
from cageik_cli.util.progress import ProgressListener
from cageik_cli.workflows.bind import WeightSettings, bind_cached, load_matching_binding
from cageik_cli.workflows.carry import carry_fit
from cageik_cli.workflows.common_scene import UNSTATED, CommonScene, Offer
from cageik_cli.workflows.mesh_source import holds_caged_model, load_source
from cageik_cli.workflows.model_file import LoadedModel, load_model, note_on
from cageik_cli.workflows.reconstruction import CageFrames, Reconstruction
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
    conversion : SceneConversion
        From the scene of `source` to that of this model.
    offer : callable, optional
        Returns the options in place of a transform of the cage, see `CommonScene.offer`.
    """

    path: Path
    model: LoadedModel
    cage: LoadedMesh | None
    result: Result | None = None
    stored: StoredBinding | None = None
    source: "CagedModel | None" = None
    conversion: SceneConversion = field(default_factory=SceneConversion)
    offer: Offer | None = None

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
        caged = CagedModel(path, load(path), None)
        if cage is not None:
            caged = caged._put_into(cage, CommonScene(caged.model.mesh.scene, given_in))
        if binding is None:
            return caged
        stored = load_matching_binding(binding, caged.model.mesh, caged.cage)
        return replace(caged, stored=stored)

    def _put_into(self, path: Path, common: CommonScene) -> "CagedModel":
        """Return the model in a cage that is read, with its source, in the scene of the model."""
        source = CagedModel._find_source(path)
        given = load_source(path, "cage") if source is None else source.cage
        assert given is not None
        conversion = common.find_conversion(given.scene)
        cage, offer = common.place_cage(given)
        return replace(self, cage=cage, source=source, conversion=conversion, offer=offer)

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
        return UNSTATED if self.result is None else self.result.scene.space

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
            raise result_file.make_weights_error(self.path, user)
        return binding

    @property
    def fit(self) -> FitRecord | None:
        """How the weights were fitted; None if they were not."""
        if self.stored is not None:
            return self.stored.binding.fit
        return None if self.result is None else self.result.fit

    def read_reconstruction(self, user: str) -> Reconstruction:
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
        if self.source is None:
            return binding
        return carry_fit(self.source, binding, weights, progress, self.conversion)


def _hold_meshes(
    path: Path,
    rest: TriMesh,
    cage: TriMesh,
    *,
    result: Result | None = None,
    stored: StoredBinding | None = None,
) -> CagedModel:
    """Return what a file holds, whose meshes have no files of their own."""
    scene = UNSTATED if result is None else result.scene.space
    model = LoadedMesh(rest, {"name": f"the rest pose of {path.name}"}, scene=scene)
    loaded = LoadedMesh(cage, {"name": f"the cage of {path.name}"}, scene=scene)
    return CagedModel(path, LoadedModel(model), loaded, result, stored)


def report_skipped_frames(result: Result, progress: ProgressListener) -> None:
    """Note which frames were skipped, and what is written instead."""
    if result.gaps:
        names = join_truncated((result.frames[k] for k in result.gaps), 5)
        progress.note(
            "note",
            f"{len(result.gaps)} of {len(result.frames)} frames skipped ({names}); their "
            "cages are interpolated, or the nearest at either end of the clip",
        )
