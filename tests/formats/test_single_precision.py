"""Times, rates and units in single precision are the numbers that were meant."""

import numpy as np
import pytest
from alembic3d.Abc import CreateArchiveWithInfo
from alembic3d.AbcCoreAbstract import TimeSampling
from pxr import Usd

from cageik_cli.formats.base.scene_graph import snap, snap_rate
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import SceneHints
from tests.clips import frames_of
from tests.formats.gltf.built import Built
from tests.formats.scenes import FRAMES, MESH, AlembicScene, UsdScene
from tests.texts import texts


@pytest.fixture
def scene(tmp_path):
    return UsdScene(tmp_path)


@pytest.mark.parametrize(
    ("number", "step", "expected"),
    [
        (1.000000052, 1, 1),
        (2999.99991, 1, 3000),
        (-3.00000002, 1, -3),
        (0.500000012, 0.5, 0.5),
        (10.80000004, 1, 10.8),
        (1.0002, 1, 1.0002),
        (101.25, 1, 101.25),
    ],
)
def test_numbers_within_a_ten_thousandth_of_a_frame_are_that_frame(number, step, expected):
    assert snap(number, step) == expected


@pytest.mark.parametrize(
    ("rate", "expected"),
    [
        (29.999998435, 30),
        (float(np.float32(24000 / 1001)), 24 / 1.001),
        (float(np.float32(30000 / 1001)), 30 / 1.001),
        (24000 / 1001, 24000 / 1001),
        (23.976, 23.976),
        (12.5, 12.5),
        (1e-5, 1e-5),
    ],
)
def test_rates_are_whole_or_those_of_video(rate, expected):
    assert snap_rate(rate) == expected


@pytest.mark.parametrize("factor", [1.0000000521540642, 0.99999997])
def test_time_codes_of_usd_are_frames(scene, factor):
    scene.mesh(times=[float(factor * k) for k in (1, 2, 3, 4)])
    scene.stage.SetTimeCodesPerSecond(29.999998435)
    sequence = scene.opened()
    assert sequence.scene == SceneHints(fps=30, start=1)
    np.testing.assert_array_equal(frames_of(sequence), FRAMES)


def test_meshes_that_are_sampled_a_rounding_apart_have_one_frame(scene):
    scene.mesh("one")
    scene.mesh("other", times=[1.0000001, 1.9999999, 3.00004, 4])
    sequence = scene.opened()
    assert (len(sequence), sequence.scene.start, texts(sequence.notes)) == (4, 1, ())
    np.testing.assert_allclose(frames_of(sequence)[:, 6:], FRAMES, rtol=0, atol=1e-5)


def test_uneven_codes_begin_with_a_frame_that_is_a_rounding_late(scene):
    scene.mesh(times=[1.00000005, 2, 4, 5.9999999])
    sequence = scene.opened()
    assert (len(sequence), sequence.scene.start) == (6, 1)


@pytest.mark.parametrize(("value", "unit"), [(1.0, 1.0), (0.01, 0.01), (0.0254, 0.0254)])
def test_a_unit_in_single_precision_is_read(tmp_path, value, unit):
    """The type is one byte in the file, behind the value."""
    path = tmp_path / "unit.usdc"
    scene = UsdScene(tmp_path, path.name)
    scene.mesh()
    scene.stage.GetRootLayer().pseudoRoot.SetInfo("metersPerUnit", 123.0)
    scene.close()
    del scene
    data = path.read_bytes()
    held = np.float32(123).tobytes() + bytes.fromhex("00000940")  # 9 is a double, in place
    assert data.count(held) == 1
    path.write_bytes(data.replace(held, np.float32(value).tobytes() + bytes.fromhex("00000840")))
    stage = Usd.Stage.Open(str(path))
    assert stage.GetRootLayer().pseudoRoot.GetInfo("metersPerUnit") == np.float32(value)
    del stage
    assert open_sequence([str(path)]).scene.metres_per_unit == unit


@pytest.mark.parametrize(
    ("name", "field"),
    [
        ("timeCodesPerSecond", "fps"),
        ("framesPerSecond", "fps"),
        ("metersPerUnit", "metres_per_unit"),
    ],
)
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_numbers_that_are_no_rates_or_units_are_as_if_not_stated(scene, name, field, value):
    scene.mesh()
    scene.stage.GetRootLayer().pseudoRoot.SetInfo(name, value)
    assert getattr(scene.opened().scene, field) is None


@pytest.mark.parametrize("value", [0.3048006096012192, 16777217.0, 1e-9 + 1 / 3, 1e30])
def test_numbers_in_double_precision_keep_their_digits(scene, value):
    """A foot of surveyors, and a frame beyond what single precision counts."""
    scene.mesh(times=[value])
    scene.stage.GetRootLayer().pseudoRoot.SetInfo("metersPerUnit", value)
    scene.stage.SetTimeCodesPerSecond(value)
    found = scene.opened().scene
    assert (found.metres_per_unit, found.fps) == (value, value)


@pytest.mark.parametrize("fps", [24, 30, 24000 / 1001])
def test_times_of_alembic_are_frames(tmp_path, fps):
    archive = AlembicScene(tmp_path)
    step, start = (float(np.float32(k / fps)) for k in (1, 11))
    archive.mesh(times=TimeSampling(step, start))
    scene = archive.opened().scene
    assert scene.fps == pytest.approx(fps, abs=1e-9)
    assert (scene.start, scene.frame_step) == (11, None)


def test_a_rate_of_alembic_in_single_precision_is_that_of_the_frames(tmp_path):
    archive = AlembicScene(tmp_path)
    archive.objects.clear()
    archive.file = None
    archive.file = CreateArchiveWithInfo(str(archive.path), 29.999998435, "test", "")
    archive.objects = {None: archive.file.getTop()}
    archive.mesh(times=TimeSampling(1 / 30, 5 / 30))
    assert archive.opened().scene == SceneHints(fps=30, start=5)


@pytest.mark.parametrize(("key", "start"), [(0.45, 10.8), (0.5, 12), (1 / 3, 8), (2.0000017, 48)])
def test_keys_of_gltf_begin_at_a_number_without_rounding(tmp_path, key, start):
    built = Built()
    attributes = {"POSITION": built.array(MESH.vertices[MESH.faces.ravel()])}
    built.add("meshes", {"primitives": [{"attributes": attributes}]})
    built.add("nodes", {"mesh": 0})
    moves = np.arange(9)[:, None] * [1.0, 0, 0]
    built.animate("", (0, "translation", key + np.arange(9) / 24, moves, "LINEAR"))
    sequence = open_sequence([str(built.save(tmp_path / "a.glb"))])
    assert (len(sequence), sequence.scene.start) == (9, start)
    moved = frames_of(sequence)[:, 0, 0] - sequence.first.vertices[0, 0]
    np.testing.assert_allclose(moved, np.arange(9), atol=1e-4)
