"""USD: one mesh whose points have a time sample per frame, in single precision."""

import zipfile
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cageik_cli.formats.base.writer import Animation, AnimationWriter
from cageik_cli.formats.npz.writer import fixed_date_zipinfo
from cageik_cli.formats.usd.errors import USD_SUFFIXES, capture_diagnostics, require_usd
from cageik_cli.formats.usd.surface_writer import UsdMesh, count_frame_bytes
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import OutputError

MAX_UNSAVED_BYTES = 1 << 26
"""Bytes of time samples in memory before they are saved; also the limit of a `.usda`, which USD
keeps in memory until the end."""

MAX_USDZ_BYTES = 1 << 32
"""Bytes of a `.usdz`: a zip file without the extension for large files."""


class UsdFile:
    """A stage whose default prim has the name of the animation, saved as it grows.

    USD reads saved samples of binary files from the disk on demand, and keeps only unsaved ones in
    memory.

    Attributes
    ----------
    root : str
        Path of the default prim, not yet defined.
    """

    def __init__(self, target: Path, animation: Animation, frame_bytes: int) -> None:
        """Start a file of `frame_bytes` per frame."""
        require_usd(f"writing {target.suffix}")
        from pxr import Sdf, Usd

        _check_size_limit(target.suffix.lower(), animation.frame_count * frame_bytes)
        self._target, self._frame_bytes, self._unsaved_bytes = target, frame_bytes, 0
        self._count, self._scene = 0, animation.scene
        self._folder: TemporaryDirectory[str] | None = None
        self._path, self._member = target, f"{animation.name}.usdc"
        if target.suffix.lower() == ".usdz":
            self._folder = TemporaryDirectory(dir=target.parent, prefix=f"{target.stem}.")
            self._path = Path(self._folder.name) / self._member
        binary = {"format": "usdc"} if target.suffix.lower() == ".usd" else {}
        with ExitStack() as stack, capture_diagnostics(OSError):
            stack.callback(self.abandon)
            self.stage = Usd.Stage.Open(Sdf.Layer.CreateNew(str(self._path), args=binary))
            _write_scene_metadata(self.stage, animation)
            self.root = f"/{animation.name}"
            self.stage.SetDefaultPrim(self.stage.OverridePrim(self.root))
            stack.pop_all()  # open from here on

    def begin_frame(self) -> float:
        """Return the time code of the next frame; samples before it may be saved."""
        with capture_diagnostics(OSError):
            if self._unsaved_bytes + self._frame_bytes > MAX_UNSAVED_BYTES:
                self.stage.GetRootLayer().Save()
                self._unsaved_bytes = 0
        self._unsaved_bytes += self._frame_bytes
        self._count += 1
        return self._scene.frame_number(self._count - 1)

    def complete(self) -> None:
        """Save what is left, and close the file."""
        with capture_diagnostics(OSError):
            self.stage.GetRootLayer().Save()
        del self.stage
        if self._folder is not None:
            _write_usdz(self._path, self._target, self._member)
            self._folder.cleanup()

    def abandon(self) -> None:
        """Close the file."""
        self.__dict__.pop("stage", None)
        if self._folder is not None:
            self._folder.cleanup()


def _write_scene_metadata(stage: Any, animation: Animation) -> None:
    from pxr import UsdGeom

    scene = animation.scene
    UsdGeom.SetStageUpAxis(stage, scene.up_axis)
    UsdGeom.SetStageMetersPerUnit(stage, scene.metres_per_unit)
    stage.SetTimeCodesPerSecond(scene.fps)
    stage.SetFramesPerSecond(scene.fps)
    stage.SetStartTimeCode(scene.start)
    stage.SetEndTimeCode(scene.frame_number(animation.frame_count - 1))


def _check_size_limit(suffix: str, size: int) -> None:
    limit = {".usda": MAX_UNSAVED_BYTES, ".usdz": MAX_USDZ_BYTES}.get(suffix)
    if limit is not None and size > limit:
        raise OutputError(
            f"{size >> 20} MiB of positions, but a {suffix} holds at most {limit >> 20} MiB; write "
            ".usdc instead"
        )


def _write_usdz(path: Path, target: Path, name: str) -> None:
    """Write a `.usdz` of one file: uncompressed, its bytes from a multiple of 64 on.

    USD's own packager would write the time.
    """
    member = fixed_date_zipinfo(name)
    header = 30 + len(name.encode()) + 4
    padding = -header % 64
    member.extra = b"\x86\x19" + padding.to_bytes(2, "little") + bytes(padding)
    with zipfile.ZipFile(target, "w") as archive, path.open("rb") as stream:
        member.file_size = path.stat().st_size
        with archive.open(member, "w") as file:
            while block := stream.read(1 << 24):
                file.write(block)


class Writer(AnimationWriter):
    """Writes each frame at the time code of its number, of the mesh `/NAME/NAME`.

    Blender names the object after the mesh, other programs after its parent.
    """

    suffixes = USD_SUFFIXES
    is_single = True

    @classmethod
    def require_libraries(cls) -> None:
        """Raise MissingLibraryError without usd-core."""
        require_usd("writing USD")

    def __init__(self, target: Path, animation: Animation) -> None:
        self._file = UsdFile(target, animation, count_frame_bytes(animation.rest))
        from pxr import UsdGeom

        with capture_diagnostics(OSError):
            # If a mesh were the default prim, the type of a referencing prim would hide it.
            UsdGeom.Xform.Define(self._file.stage, self._file.root)
            path = f"{self._file.root}/{animation.name}"
            self._mesh = UsdMesh(self._file.stage, path, animation.rest)

    def append(self, frames: Floats) -> None:
        """Write the next frames."""
        for positions in frames:
            time = self._file.begin_frame()
            with capture_diagnostics(OSError):
                self._mesh.write_positions(positions, time)

    def complete(self) -> None:
        """Save the file."""
        self._file.complete()

    def abandon(self) -> None:
        """Close the file."""
        self._file.abandon()
