"""Alembic: one polygon mesh, in single precision."""

import errno
import os
import shutil
from pathlib import Path

import numpy as np

from cageik_cli.export.animation import Animation, AnimationWriter
from cageik_cli.export.single_precision import single_precision
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import needing


class Writer(AnimationWriter):
    """Frame k at second (start + k) / fps of the mesh `/NAME`; faces turn clockwise there."""

    suffixes = (".abc",)

    @classmethod
    def require(cls) -> None:
        """Refuse to go on without alembic3d."""
        with needing("alembic3d", "abc", "writing .abc"):
            import alembic3d  # noqa: F401

    def __init__(self, target: Path, animation: Animation) -> None:
        with needing("alembic3d", "abc", "writing .abc"):
            from alembic3d.Abc import OArchive
            from alembic3d.AbcCoreAbstract import TimeSampling
            from alembic3d.AbcGeom import OPolyMesh
            from imath import IntArray, IntArrayFromBuffer

        _refuse_full_disk(target, animation)
        scene, faces = animation.scene, animation.rest.faces
        corners = np.ascontiguousarray(faces[:, ::-1], np.int32).ravel()
        self._faces = (IntArrayFromBuffer(corners), IntArray(3, len(faces)))
        try:
            # An archive made with what made it would say when, too.
            archive = OArchive(str(target))
            times = archive.addTimeSampling(TimeSampling(1 / scene.fps, scene.start / scene.fps))
            mesh = OPolyMesh(archive.getTop(), animation.name, times)
        except RuntimeError as error:
            raise OSError(str(error)) from error
        # The last that holds the file: it closes when this goes.
        self._schema = mesh.getSchema()

    def append(self, frames: Floats) -> None:
        """Write the next frames."""
        from alembic3d.AbcGeom import OPolyMeshSchemaSample
        from imath import V3fArrayFromBuffer

        for points in map(single_precision, frames):
            positions = V3fArrayFromBuffer(points)
            self._schema.set(OPolyMeshSchemaSample(positions, *self._faces))

    def complete(self) -> None:
        """Close the file."""
        del self._schema

    def abandon(self) -> None:
        """Close the file."""
        self.__dict__.pop("_schema", None)


def _refuse_full_disk(target: Path, animation: Animation) -> None:
    """Refuse what will not fit: Alembic ends the process when a last write fails."""
    size = 12 * animation.count * len(animation.rest.vertices) + 16 * len(animation.rest.faces)
    if size > shutil.disk_usage(target.parent).free:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
