"""A cage animation and the model that it moves, in one stage of USD."""

from enum import Enum
from pathlib import Path

from cageik_cli.formats.base.writer import Animation, AnimationWriter
from cageik_cli.formats.usd.errors import USD_SUFFIXES, capture_diagnostics, require_usd
from cageik_cli.formats.usd.surface_writer import UsdMesh, count_frame_bytes
from cageik_cli.formats.usd.writer import UsdFile
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats

MODEL_NAME = "model"


class CageDisplay(Enum):
    """How a cage is shown beside its model."""

    MESH = "mesh"
    """As any mesh."""

    GUIDE = "guide"
    """With the purpose `guide`: programs hide it unless they are asked, and never render it."""


class WithModelWriter(AnimationWriter):
    """Writes the cages as the mesh `/NAME/NAME`, and beside them the model, `/NAME/model`.

    The vertices of a frame are those of the cage, then those of the model.
    """

    suffixes = USD_SUFFIXES
    is_single = True

    @classmethod
    def require_libraries(cls) -> None:
        """Raise MissingLibraryError without usd-core."""
        require_usd("writing USD")

    def __init__(
        self, target: Path, animation: Animation, model: TriMesh, cage: CageDisplay
    ) -> None:
        """Start writing to `target`, whose suffix is one of `suffixes`.

        Parameters
        ----------
        animation : Animation
            Of the cage: its `rest` is the rest cage.
        model : TriMesh
            The model at rest.
        """
        self._cage_count = len(animation.rest.vertices)
        size = count_frame_bytes(animation.rest) + count_frame_bytes(model)
        self._file = UsdFile(target, animation, size)
        from pxr import UsdGeom

        with capture_diagnostics(OSError):
            stage, root = self._file.stage, self._file.root
            UsdGeom.Xform.Define(stage, root)
            self._cage = define_cage(self._file, animation, cage)
            self._model = UsdMesh(stage, f"{root}/{MODEL_NAME}", model)

    def append(self, frames: Floats) -> None:
        """Write the next k frames, (k, n + m, 3)."""
        for positions in frames:
            time = self._file.begin_frame()
            with capture_diagnostics(OSError):
                self._cage.write_positions(positions[: self._cage_count], time)
                self._model.write_positions(positions[self._cage_count :], time)

    def complete(self) -> None:
        """Save the file."""
        self._file.complete()

    def abandon(self) -> None:
        """Close the file."""
        self._file.abandon()


def define_cage(file: UsdFile, animation: Animation, display: CageDisplay) -> UsdMesh:
    """Define the mesh of the cage beside another."""
    from pxr import UsdGeom

    mesh = UsdMesh(file.stage, f"{file.root}/{animation.name}", animation.rest)
    if display == CageDisplay.GUIDE:
        mesh.prim.CreatePurposeAttr(UsdGeom.Tokens.guide)
    return mesh
