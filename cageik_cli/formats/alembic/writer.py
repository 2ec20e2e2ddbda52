"""An animation as an Alembic archive."""

import errno
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.formats.alembic.library import FPS_KEY, require_alembic
from cageik_cli.formats.alembic.paths import place_meshes
from cageik_cli.formats.base.files import require_unicode
from cageik_cli.formats.base.writers import Animation, AnimationWriter, to_float32
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import compute_corner_normals
from cageik_cli.util.arrays import Floats


class Writer(AnimationWriter):
    """Each frame at its number / fps seconds, of each part at its path; faces turn clockwise there.

    A mesh that came as one is `/NAME`.
    """

    suffixes = (".abc",)
    is_single = True
    keeps_parts = True

    @classmethod
    def require_libraries(cls) -> None:
        """Raise MissingLibraryError without alembic3d."""
        require_alembic("writing .abc")

    def __init__(self, target: Path, animation: Animation) -> None:
        self.require_libraries()
        from alembic3d.Abc import OArchive
        from alembic3d.AbcCoreAbstract import MetaData, TimeSampling
        from alembic3d.AbcGeom import OPolyMesh

        _check_disk_space(target, animation)
        scene, parts = animation.scene, animation.split()
        try:
            # With a name of the program, the archive would hold the time, too.
            archive = OArchive(require_unicode(target))
            step, start = scene.frame_step / scene.fps, scene.start / scene.fps
            times = archive.addTimeSampling(TimeSampling(step, start))
            stated = MetaData()
            stated.set(FPS_KEY, f"{scene.fps:.12g}")
            paths = [f"/{part.name.strip('/')}" for part in parts]
            are_still = [np.array_equal(part.transform, np.eye(4)) for part in parts]
            places = [path.rpartition("/") for path in place_meshes(paths, are_still)]
            matrices: dict[str, Floats] = {}
            for (above, _, _), part in zip(places, parts, strict=True):
                matrices.setdefault(above, part.transform)
            tree = _TransformTree(archive.getTop(), matrices)
            # The last references to the file: it is closed with these.
            self._meshes = []
            for (above, _, name), part in zip(places, parts, strict=True):
                schema = OPolyMesh(tree.define(above), name, stated, times).getSchema()
                self._meshes.append((schema, _AlembicSurface(part.own_mesh), part))
        except RuntimeError as error:
            raise OSError(str(error)) from error

    def append(self, frames: Floats) -> None:
        """Write the next frames."""
        for positions in frames:
            for schema, surface, part in self._meshes:
                schema.set(surface.make_sample(part.select(positions)))

    def complete(self) -> None:
        """Write what is of all frames, and close the file."""
        for schema, surface, _ in self._meshes:
            surface.write_face_sets(schema)
        self.abandon()

    def abandon(self) -> None:
        """Close the file."""
        self.__dict__.pop("_meshes", None)


def _check_disk_space(target: Path, animation: Animation) -> None:
    """Refuse what does not fit: Alembic ends the process when its last write fails."""
    rest = animation.rest
    corners = 0 if rest.attributes is None else len(rest.attributes.corners)
    size = 12 * animation.frame_count * (len(rest.vertices) + corners) + 16 * len(rest.faces)
    size += 1 << 16  # at most, besides the arrays
    if size > shutil.disk_usage(target.parent).free:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


class _AlembicSurface:
    """The faces of a mesh as Alembic has them, clockwise, with their UVs and normals."""

    def __init__(self, mesh: TriMesh) -> None:
        from alembic3d.AbcGeom import GeometryScope, OV2fGeomParamSample
        from imath import IntArrayFromBuffer, UnsignedIntArray, V2fArrayFromBuffer

        self._attributes = attributes = mesh.polygons.reverse(keeps_first=False)
        self._faces = tuple(
            IntArrayFromBuffer(np.ascontiguousarray(part, np.int32))
            for part in (attributes.corners, attributes.corner_counts)
        )
        self._uvs = None
        if attributes.uvs is not None:  # of corners; those without are at zero
            values, indices = attributes.uvs.complete()
            numbers = UnsignedIntArray(len(indices))
            for place, index in enumerate(indices.tolist()):
                numbers[place] = index
            table = V2fArrayFromBuffer(to_float32(values))
            self._uvs = OV2fGeomParamSample(table, numbers, GeometryScope.kFacevaryingScope)

    def make_sample(self, positions: Floats) -> Any:
        """Return the sample of a frame, (m, 3)."""
        from alembic3d.AbcGeom import (
            GeometryScope,
            ON3fGeomParamSample,
            OPolyMeshSchemaSample,
            OV2fGeomParamSample,
        )
        from imath import V3fArrayFromBuffer

        points = V3fArrayFromBuffer(to_float32(positions))
        attributes = self._attributes
        if attributes.normal_fans is None and self._uvs is None:
            return OPolyMeshSchemaSample(points, *self._faces)
        uvs = self._uvs or OV2fGeomParamSample()
        if attributes.normal_fans is None:
            return OPolyMeshSchemaSample(points, *self._faces, uvs)
        # Of faces that are turned, they point inward.
        normals = V3fArrayFromBuffer(to_float32(-compute_corner_normals(attributes, positions)))
        sample = ON3fGeomParamSample(normals, GeometryScope.kFacevaryingScope)
        return OPolyMeshSchemaSample(points, *self._faces, uvs, sample)

    def write_face_sets(self, schema: Any) -> None:
        """Write a face set for each material, which other programs take as such."""
        from alembic3d.AbcGeom import OFaceSetSchemaSample
        from imath import IntArrayFromBuffer

        labels = self._attributes.materials
        taken: set[str] = set()
        for name, polygons in labels.list_members() if labels is not None else ():
            name = name.replace("/", "_")  # a slash would be a path
            while name in taken:
                name += "_"
            taken.add(name)
            faces = IntArrayFromBuffer(np.ascontiguousarray(polygons, np.int32))
            schema.createFaceSet(name).getSchema().set(OFaceSetSchemaSample(faces))


class _TransformTree:
    """The transforms above meshes, which are written as they are needed.

    Parameters
    ----------
    top : OObject
        The top of the archive.
    matrices : dict
        The transforms (4, 4) into the scene that some of them have, by their paths.
    """

    def __init__(self, top: Any, matrices: dict[str, Floats]) -> None:
        self._objects: dict[str, Any] = {"": top}
        self._matrices = {**matrices, "": np.eye(4)}

    def define(self, path: str) -> Any:
        """Return the transform at a path; those above it are written first."""
        if path not in self._objects:
            import imath
            from alembic3d.AbcGeom import OXform, XformSample

            above, _, name = path.rpartition("/")
            parent = self.define(above)
            matrix = self._matrices.setdefault(path, self._matrices[above])
            local = matrix @ np.linalg.inv(self._matrices[above])
            transform = OXform(parent, name)
            if not np.array_equal(local, np.eye(4)):
                sample = XformSample()
                sample.setMatrix(imath.M44d(*local.ravel().tolist()))
                transform.getSchema().set(sample)
            self._objects[path] = transform
        return self._objects[path]
