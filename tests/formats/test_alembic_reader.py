"""Clips in Alembic: archives that alembic3d wrote, in every way that scenes differ."""

import alembic3d  # noqa: F401  # before imath, which is its own
import imath
import numpy as np
import pytest
from alembic3d.Abc import OArchive
from alembic3d.AbcCoreAbstract import AcyclicFlag, TimeSampling, TimeSamplingType, TimeVector
from alembic3d.AbcGeom import OPolyMeshSchemaSample, OXform, XformSample

from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import ClipSettings, SceneHints
from cageik_cli.util.errors import (
    ConnectivityError,
    FormatError,
    InputError,
    SettingError,
)
from tests.clips import frames_of
from tests.formats.kinds import add_abc_mesh
from tests.shapes import octahedron

MESH = octahedron()
FRAMES = (MESH.vertices + np.random.default_rng(2).normal(0, 0.1, (4, 6, 3))).astype("f4")
CLOCKWISE = MESH.faces[:, ::-1]
EVERY_24TH = TimeSampling(1 / 24, 1 / 24)


class Archive:
    """An archive under construction, to be opened by our reader."""

    def __init__(self, path):
        self.path, self.file = path, OArchive(str(path))
        self.objects = {None: self.file.getTop()}

    def mesh(self, name="mesh", parent=None, times=EVERY_24TH, frames=FRAMES, faces=CLOCKWISE):
        parent = self.objects[parent]
        self.objects[name] = add_abc_mesh(self.file, parent, name, times, frames, faces)

    def transform(self, matrices, name="move", parent=None, times=EVERY_24TH, inherits=True):
        number = self.file.addTimeSampling(times)
        transform = OXform(self.objects[parent], name, number)
        for matrix in matrices:
            sample = XformSample()
            sample.setMatrix(imath.M44d(*map(float, np.asarray(matrix).ravel())))
            sample.setInheritsXforms(inherits)
            transform.getSchema().set(sample)
        self.objects[name] = transform

    def opened(self, member="", **how):
        # The file closes when the last that belongs to it goes.
        self.objects.clear()
        del self.file
        return open_sequence([f"{self.path}{member}"], ClipSettings(**how))

    def refused(self, member=""):
        with pytest.raises(InputError) as caught:
            frames_of(self.opened(member))
        return str(caught.value).removeprefix(f"{self.path}: ")


@pytest.fixture
def archive(tmp_path):
    return Archive(tmp_path / "clip.abc")


def translation(*by):
    matrix = np.eye(4)
    matrix[3, :3] = by
    return matrix


def test_the_scene_is_what_the_times_say(archive):
    archive.mesh(times=TimeSampling(1 / 30, 11 / 30))
    assert archive.opened().scene == SceneHints(fps=30.0, start=11.0)


def test_every_second_frame(archive):
    archive.mesh(times=TimeSampling(1001 / 24000, 1001 / 24000))
    sequence = archive.opened(selection=slice(1, None, 2))
    assert sequence.scene == SceneHints(fps=round(24000 / 1001, 9), start=2.0, frame_step=2)
    np.testing.assert_array_equal(frames_of(sequence), FRAMES[1::2])


def test_uneven_samples_are_taken_one_after_the_other(archive):
    times = TimeVector()
    times.extend([0.0, 0.1, 0.5, 0.6])
    archive.mesh(times=TimeSampling(TimeSamplingType(AcyclicFlag.kAcyclic), times))
    sequence = archive.opened()
    np.testing.assert_array_equal(frames_of(sequence), FRAMES)
    assert sequence.scene == SceneHints()
    assert sequence.notes == (
        "clip.abc: its 4 samples are not evenly spaced in time; each is used as one frame",
    )


def test_points_are_moved_by_all_transforms_above(archive):
    turn = [[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]  # x to y, y to -x
    archive.transform([translation(1, 2, 3)], "outer")
    archive.transform([turn], "turn", "outer")
    archive.mesh(parent="turn")
    sequence = archive.opened()
    x, y, z = FRAMES.astype(float).transpose(2, 0, 1)
    expected = np.stack([1 - y, 2 + x, 3 + z], axis=2)
    np.testing.assert_allclose(frames_of(sequence), expected, rtol=0, atol=1e-15)
    assert sequence.notes == ("clip.abc: moved by its transform into the scene's space",)


def test_a_transform_may_leave_those_above(archive):
    archive.transform([translation(1, 2, 3)], "outer")
    archive.transform([translation(0, 0, 1)], "inner", "outer", inherits=False)
    archive.mesh(parent="inner")
    shifted = FRAMES + np.array([0, 0, 1.0])
    np.testing.assert_allclose(frames_of(archive.opened()), shifted, rtol=1e-15)


def test_a_mesh_moved_by_its_parent_alone(archive):
    archive.transform([translation(k, 0, 0) for k in range(3)])
    archive.mesh(parent="move", frames=FRAMES[:1])
    sequence = archive.opened()
    expected = [FRAMES[0] + np.array([float(k), 0, 0]) for k in range(3)]
    np.testing.assert_allclose(frames_of(sequence), expected, rtol=1e-15)
    assert sequence.notes == ("clip.abc: moved by its animated transform into the scene's space",)
    assert sequence.scene == SceneHints(fps=24.0, start=1.0)


def test_transforms_of_other_times_are_taken_in_proportion(archive):
    """Points at frames 1 to 4, the transform at 1, 3 and 5: halfway at frames 2 and 4."""
    archive.transform([translation(k, 0, 0) for k in (0, 2, 6)], times=TimeSampling(2 / 24, 1 / 24))
    archive.mesh(parent="move")
    shifts = frames_of(archive.opened()) - FRAMES
    np.testing.assert_allclose(shifts[:, :, 0], np.repeat([[0], [1], [2], [4]], 6, 1), atol=1e-12)


def test_a_transform_without_samples_moves_nothing(archive):
    archive.transform([])
    archive.mesh(parent="move")
    sequence = archive.opened()
    np.testing.assert_array_equal(frames_of(sequence), FRAMES)
    assert sequence.notes == ()


def test_faces_of_a_mirrored_mesh_turn(archive):
    archive.transform([np.diag([-1, 1, 1, 1])])
    archive.mesh(parent="move", frames=[MESH.vertices])
    np.testing.assert_allclose(archive.opened().first.volume, MESH.volume, rtol=1e-6)


def test_polygons_are_cut(archive):
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    archive.mesh(frames=[corners], faces=[[3, 2, 1, 0]])
    sequence = archive.opened()
    assert sequence.first.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert sequence.notes == ("clip.abc: 1 polygon cut into triangles to compute with",)


def test_one_of_several_meshes_is_named(archive):
    archive.mesh()
    archive.transform([np.eye(4)])
    archive.mesh("hat", "move", frames=FRAMES + 1)
    sentence = "holds 2 meshes, expected one: /mesh, /move/hat"
    assert archive.refused().startswith(sentence)
    sequence = open_sequence([f"{archive.path}::/move/hat"])
    np.testing.assert_array_equal(frames_of(sequence), FRAMES + np.float32(1))
    assert sequence.names[0] == "clip.abc::/move/hat[0]"
    with pytest.raises(SettingError, match=r"clip\.abc: .*`/shoe`.* /mesh, /move/hat"):
        open_sequence([f"{archive.path}::/shoe"])


def test_an_archive_without_a_mesh(archive):
    archive.transform([np.eye(4)])
    assert archive.refused().startswith("holds no mesh")


def test_faces_that_change_are_refused(archive):
    archive.mesh()
    corners = imath.IntArray(3)
    corners[1], corners[2] = 1, 2
    faces = (corners, imath.IntArray(3, 1))
    archive.objects["mesh"].set(OPolyMeshSchemaSample(imath.V3fArray(6), *faces))
    sentence = "the faces change at time 4; all frames must share one connectivity"
    assert archive.refused() == sentence


def test_vertices_that_change_in_number_are_refused(archive):
    archive.mesh(frames=[*FRAMES[:2], FRAMES[2][:5]])
    with pytest.raises(ConnectivityError, match=r"clip\.abc\[2\]: 5 vertices, the rest pose has 6"):
        frames_of(archive.opened())


@pytest.mark.parametrize(
    ("spoiled", "sentence"),
    [
        ({"frames": [np.zeros((0, 3))]}, "vertices have shape (0, 3), expected (count, 3)"),
        ({"faces": []}, "0 faces need 0 corners"),
        ({"faces": [[0, 1, 6]]}, "face 0 names vertices 0, 1, 6 (counted from 0), but there are 6"),
        ({"frames": []}, "is not a sound Alembic file ("),
    ],
)
def test_what_makes_no_clip_is_a_sentence(archive, spoiled, sentence):
    archive.mesh(**spoiled)
    assert archive.refused().startswith(sentence)


def test_a_file_that_was_never_closed_is_a_sentence(archive):
    archive.mesh()
    archive.opened()
    data = bytearray(archive.path.read_bytes())
    data[5] = 0
    archive.path.write_bytes(data)
    with pytest.raises(FormatError, match=r"clip\.abc: is cut short"):
        open_sequence([str(archive.path)])


def test_a_sample_that_is_missing_is_a_sentence(archive):
    """The library itself would crash; a sample is found by where its size and digest begin."""
    archive.mesh()
    archive.opened()
    data = archive.path.read_bytes()
    place = data.index(FRAMES[1].tobytes()) - 16 - 8
    there = (place | 1 << 63).to_bytes(8, "little")
    assert data.count(there) == 1
    archive.path.write_bytes(data.replace(there, bytes(8)))
    with pytest.raises(FormatError, match=r"clip\.abc\[1\]: sample 1 of `P` is missing"):
        frames_of(open_sequence([str(archive.path)]))


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"", "is not an Alembic file"),
        (b"no Alembic\n" * 9, "is not an Alembic file"),
        (b"\x89HDF\r\n\x1a\n" + bytes(99), "is an old Alembic file"),
        (b"Ogawa\xff\0\1" + b"\x10" + bytes(99), "is not a sound Alembic file ("),
    ],
)
def test_what_is_no_alembic_is_a_sentence(tmp_path, data, sentence):
    path = tmp_path / "clip.abc"
    path.write_bytes(data)
    with pytest.raises(FormatError) as caught:
        open_sequence([str(path)])
    assert str(caught.value).startswith(f"{path}: {sentence}")
