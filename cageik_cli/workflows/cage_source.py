"""A model at rest in its cage, with its weights: from a result or from a binding."""

from dataclasses import dataclass
from pathlib import Path

from cageik_cli.coordinates.binding import Binding
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.formats.base.hdf5 import HDF5_SUFFIXES
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.settings import Scene
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.solver.fitting.record import FitRecord
from cageik_cli.store import binding_file, result_frames
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.result import Result, read_result
from cageik_cli.util.errors import SettingError, error_context


@dataclass(frozen=True, slots=True, eq=False)
class CageSource:
    """A model at rest in its cage, from a result or from a binding.

    Attributes
    ----------
    result : Result, optional
        With the cages of a clip.
    """

    path: Path
    rest: TriMesh
    cage: TriMesh
    bind: BindSettings
    scene: Scene
    result: Result | None = None
    stored: StoredBinding | None = None

    @staticmethod
    def read(path: Path) -> "CageSource":
        """Read a result or a binding.

        Raises
        ------
        InputError
            When it is neither, or damaged.
        """
        if path.exists() and path.suffix.lower() in HDF5_SUFFIXES and binding_file.is_binding(path):
            stored = binding_file.read_binding(path)
            held = stored.binding
            return CageSource(path, held.rest, held.cage, held.settings, Scene(), stored=stored)
        result = read_result(path)
        bind = _read_bind_settings(result)
        return CageSource(path, result.rest, result.cage, bind, result.scene, result)

    @property
    def cage_name(self) -> str:
        """The name of the rest cage in messages."""
        return "the binding's cage" if self.result is None else "the result's cage"

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

    @property
    def rest_cage(self) -> LoadedMesh:
        """The rest cage as a mesh that was read."""
        return LoadedMesh(self.cage, {"name": f"the cage of {self.path.name}"})

    @property
    def rest_model(self) -> LoadedMesh:
        """The rest pose as a mesh that was read."""
        return LoadedMesh(self.rest, {"name": f"the rest pose of {self.path.name}"})

    def read_binding(self) -> Binding | None:
        """Read the weights; None if a result was written without."""
        if self.stored is not None:
            return self.stored.binding
        return result_frames.read_binding(self.result) if self.result is not None else None

    @property
    def fit(self) -> FitRecord | None:
        """How the weights were fitted; None if they were not."""
        if self.stored is not None:
            return self.stored.binding.fit
        return self.result.fit if self.result is not None else None


def _read_bind_settings(result: Result) -> BindSettings:
    with error_context(result.path):
        names = ("coordinates", "accuracy", "outside")
        return BindSettings(**{name: str(result.settings.get(name)) for name in names})
