"""Scenes of one or several meshes under construction, in USD and in Alembic, for tests."""

import alembic3d  # noqa: F401  # before imath, which is its own
import imath
import numpy as np
import pytest
from alembic3d.Abc import OArchive
from alembic3d.AbcCoreAbstract import TimeSampling
from alembic3d.AbcGeom import OXform, XformSample
from pxr import Gf, Usd, UsdGeom

from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.util.errors import InputError
from tests.clips import frames_of
from tests.formats.kinds import add_abc_mesh, add_usd_mesh
from tests.shapes import octahedron

MESH = octahedron()
FRAMES = (MESH.vertices + np.random.default_rng(2).normal(0, 0.1, (4, 6, 3))).astype("f4")
EVERY_24TH = TimeSampling(1 / 24, 1 / 24)


class BuiltScene:
    """A file that is closed when our reader opens it."""

    def opened(self, member="", **how):
        self.close()
        return open_sequence([f"{self.path}{member}"], ClipSettings(**how))

    def refused(self, member="", **how):
        with pytest.raises(InputError) as caught:
            frames_of(self.opened(member, **how))
        place, _, sentence = str(caught.value).partition(": ")
        assert self.path.name in place
        return sentence


class UsdScene(BuiltScene):
    """A stage; frames are at the time codes 1, 2, 3, and a single one at none."""

    def __init__(self, folder, name="clip.usda"):
        self.path = folder / name
        self.stage = Usd.Stage.CreateNew(str(self.path))
        self.places = {None: ""}

    def close(self):
        self.stage.GetRootLayer().Save()

    def mesh(self, name="mesh", parent=None, frames=FRAMES, faces=MESH.faces, times=None):
        self.places[name] = f"{self.places[parent]}/{name}"
        if times is None:
            times = range(1, len(frames) + 1) if len(frames) > 1 else ()
        return add_usd_mesh(self.stage, self.places[name], frames, times, faces)

    def transform(self, matrices, name="move", parent=None, inherits=True):
        self.places[name] = f"{self.places[parent]}/{name}"
        transform = UsdGeom.Xform.Define(self.stage, self.places[name])
        operation = transform.AddTransformOp()
        transform.SetResetXformStack(not inherits)
        for time, matrix in enumerate(matrices, start=1):
            values = Gf.Matrix4d(np.asarray(matrix, float).tolist())
            operation.Set(values, time if len(matrices) > 1 else Usd.TimeCode.Default())


class AlembicScene(BuiltScene):
    """An archive, which has faces clockwise."""

    def __init__(self, folder):
        self.path = folder / "clip.abc"
        self.file = OArchive(str(self.path))
        self.objects = {None: self.file.getTop()}

    def close(self):
        # The file closes when the last that belongs to it goes.
        self.objects.clear()
        self.file = None

    def mesh(self, name="mesh", parent=None, frames=FRAMES, faces=MESH.faces, times=EVERY_24TH):
        parent, clockwise = self.objects[parent], [list(face)[::-1] for face in faces]
        self.objects[name] = add_abc_mesh(self.file, parent, name, times, frames, clockwise)

    def transform(self, matrices, name="move", parent=None, inherits=True, times=EVERY_24TH):
        number = self.file.addTimeSampling(times)
        transform = OXform(self.objects[parent], name, number)
        for matrix in matrices:
            sample = XformSample()
            sample.setMatrix(imath.M44d(*map(float, np.asarray(matrix).ravel())))
            sample.setInheritsXforms(inherits)
            transform.getSchema().set(sample)
        self.objects[name] = transform


def translation(*by):
    matrix = np.eye(4)
    matrix[3, :3] = by
    return matrix
