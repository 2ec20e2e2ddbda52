"""USD: one mesh whose points have a time sample a frame, in single precision."""

from pathlib import Path

from cageik_cli.export.animation import Animation, AnimationWriter
from cageik_cli.export.single_precision import single_precision
from cageik_cli.export.usd_file import UsdFile, define_mesh, extent_of
from cageik_cli.usd import SUFFIXES, need_usd, quiet
from cageik_cli.util.arrays import Floats


class Writer(AnimationWriter):
    """Frame k at time code start + k of the mesh `/NAME/NAME`.

    Blender calls the object by the mesh, others by its parent.
    """

    suffixes = SUFFIXES

    @classmethod
    def require(cls) -> None:
        """Refuse to go on without usd-core."""
        need_usd("writing USD")

    def __init__(self, target: Path, animation: Animation) -> None:
        self._file = UsdFile(target, animation, 12 * len(animation.rest.vertices))
        from pxr import UsdGeom

        with quiet(OSError):
            # A mesh as the default prim would be hidden by the type of whatever references it.
            UsdGeom.Xform.Define(self._file.stage, self._file.root)
            mesh = define_mesh(
                self._file.stage, f"{self._file.root}/{animation.name}", animation.rest
            )
            self._points, self._extent = mesh.CreatePointsAttr(), mesh.CreateExtentAttr()

    def append(self, frames: Floats) -> None:
        """Write the next frames."""
        from pxr import Vt

        for points in map(single_precision, frames):
            time = self._file.next_time()
            with quiet(OSError):
                self._points.Set(Vt.Vec3fArray.FromNumpy(points), time)
                self._extent.Set(extent_of(points), time)

    def complete(self) -> None:
        """Save the file."""
        self._file.complete()

    def abandon(self) -> None:
        """Close the file."""
        self._file.abandon()
