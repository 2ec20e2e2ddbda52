"""Transforms and rigs with few keys are sampled at the rate of the clip, not at the keys alone."""

import alembic3d  # noqa: F401  # before imath, which is its own
import imath
import numpy as np
import pytest
from alembic3d.Abc import CreateArchiveWithInfo
from alembic3d.AbcCoreAbstract import AcyclicFlag, TimeSampling, TimeSamplingType, TimeVector
from alembic3d.AbcGeom import OXform, XformSample
from pxr import Gf, UsdGeom
from scipy.spatial.transform import Rotation

from cageik_cli.formats.base.scene_graph import blend_transforms, sample_evenly
from cageik_cli.util.errors import FormatError
from tests.clips import frames_of
from tests.formats.scenes import FRAMES, AlembicScene, UsdScene
from tests.formats.usd import rigs
from tests.formats.usd.rigs import Rig
from tests.texts import texts

STILL = FRAMES[:1]


def spin(degrees, axis="y"):
    return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()


def expect(angles):
    """The still mesh, turned about y by each of some angles in degrees."""
    return np.array([STILL[0] @ spin(angle).T for angle in angles])


def warnings_of(sequence):
    return [note.text for note in sequence.notes if note.kind == "warning"]


@pytest.fixture
def scene(tmp_path):
    """A turntable: half a turn by two keys, at 0 and 24."""
    scene = UsdScene(tmp_path)
    scene.mesh(frames=STILL)
    turn = UsdGeom.Xformable(scene.stage.GetPrimAtPath("/mesh")).AddRotateYOp()
    for time, angle in ((0, 0), (24, 180)):
        turn.Set(angle, time)
    scene.turn = turn
    return scene


def set_range(scene, first, last, codes=24, fps=None):
    scene.stage.SetStartTimeCode(first)
    scene.stage.SetEndTimeCode(last)
    scene.stage.SetTimeCodesPerSecond(codes)
    if fps:
        scene.stage.SetFramesPerSecond(fps)


@pytest.mark.parametrize(
    ("first", "last", "times"),
    [
        (0, 24, range(25)),
        (0, 12, range(13)),
        (-4, 30, range(-4, 31)),
        (3, 5, range(3, 6)),
        (0.5, 3.5, [0.5, 1.5, 2.5, 3.5]),
    ],
)
def test_frames_are_those_of_the_range_of_a_stage(scene, first, last, times):
    set_range(scene, first, last)
    sequence = scene.opened()
    np.testing.assert_allclose(
        frames_of(sequence), expect([np.clip(t, 0, 24) * 7.5 for t in times]), atol=1e-6
    )
    assert sequence.scene.start == times[0]
    assert sequence.scene.frame_step is None
    assert (
        f"its motion has 2 keys from 0 to 24: frames are those of its range, {first}"
        in " ".join(texts(sequence.notes))
    )
    assert not warnings_of(sequence)


def test_frames_are_at_the_rate_of_a_stage(scene):
    set_range(scene, 0, 24, codes=24, fps=12)
    sequence = scene.opened()
    assert (len(sequence), sequence.scene.frame_step) == (13, 2)
    np.testing.assert_allclose(frames_of(sequence), expect(np.arange(13) * 15), atol=1e-6)


@pytest.mark.parametrize("span", [None, (0, 0), (48, 96), (10, 5)])
def test_without_a_range_frames_are_between_the_keys_and_that_is_said_first(scene, span):
    if span:
        set_range(scene, *span)
    sequence = scene.opened()
    np.testing.assert_allclose(frames_of(sequence), expect(np.arange(25) * 7.5), atol=1e-6)
    (warning,) = warnings_of(sequence)
    assert str(warning).endswith(
        "its motion has 2 keys from 0 to 24, and it states no range: frames are at the whole time "
        "codes 0 to 24; choose others by `selection=`"
    )


@pytest.mark.parametrize(
    ("codes", "fps", "span", "step"),
    [
        (1, 24, (0, 24), 1 / 24),
        (1, None, (0, 24), 1 / 24),
        (8, 24, (0, 24), 1 / 3),
        (24000, None, (0, 24000), 1000),
        (24000, 30, (0, 24000), 800),
        (240, None, (0, 24), 1),
        (24, 60, (0, 24), 1),
        (12, None, (0, 24), 1),
        (None, 48, (0, 24), 1),
        (1e-30, 24, (0, 24), 1),
        (0.5, None, (0, 24), 1),
    ],
)
@pytest.mark.parametrize("has_range", [True, False])
def test_time_codes_of_a_clock_are_no_frames(scene, codes, fps, span, step, has_range):
    """Of seconds, or of fine parts of them; frames are at the rate of the stage, or 24."""
    scene.turn.GetAttr().Clear()
    for time, angle in zip(span, (0, 170), strict=True):
        scene.turn.Set(angle, time)
    if codes:
        scene.stage.SetTimeCodesPerSecond(codes)
    if fps:
        scene.stage.SetFramesPerSecond(fps)
    if has_range:
        scene.stage.SetStartTimeCode(span[0])
        scene.stage.SetEndTimeCode(span[1])
    sequence = scene.opened()
    count = round(span[1] / step) + 1
    assert len(sequence) == count
    assert sequence.scene.frame_step == (None if step == 1 else round(step, 6))
    angles = np.linspace(0, 170, count)
    np.testing.assert_allclose(sequence.read_frame(7), expect(angles[7:8])[0], atol=1e-6)
    np.testing.assert_allclose(sequence.read_frame(count - 1), expect([170])[0], atol=1e-6)
    assert len(warnings_of(sequence)) == (0 if has_range else 1)


def test_a_range_that_is_too_long_is_not_sampled_and_that_is_said_first(scene):
    set_range(scene, -3, 1e6)
    sequence = scene.opened()
    np.testing.assert_allclose(frames_of(sequence), expect(np.arange(25) * 7.5), atol=1e-6)
    (warning,) = warnings_of(sequence)
    assert "and its range, -3 to 1000000, is too long: frames are at the whole tim" in str(warning)


def test_uneven_keys_are_sampled_evenly(scene):
    scene.turn.Set(30, 3.7)
    assert len(scene.opened()) == 25
    set_range(scene, 1, 6)
    assert len(scene.opened()) == 6


def test_keys_of_what_is_above_and_of_quaternions(tmp_path):
    scene = UsdScene(tmp_path)
    scene.transform([np.eye(4)], "above")
    scene.mesh(parent="above", frames=STILL)
    above = UsdGeom.Xformable(scene.stage.GetPrimAtPath("/above"))
    above.ClearXformOpOrder()
    turn = above.AddOrientOp()
    for time, half in ((0, 0), (10, np.pi / 4), (20, np.pi / 2)):
        turn.Set(Gf.Quatf(float(np.cos(half)), 0, float(np.sin(half)), 0), time)
    set_range(scene, 0, 20)
    found = frames_of(scene.opened())
    np.testing.assert_allclose(found, expect(np.arange(21) * 9), atol=1e-6)


def test_points_that_are_baked_decide_when_frames_are(scene):
    """Every fifth code, as a transform beside them has keys."""
    set_range(scene, 1, 16)
    scene.mesh("baked", times=(1, 6, 11, 16))
    scene.turn.GetAttr().Clear()
    for time in (1, 6, 11, 16):
        scene.turn.Set(time, time)
    sequence = scene.opened()
    assert (len(sequence), sequence.scene.frame_step) == (4, 5)


def test_two_shapes_of_points_are_keys_too(scene):
    scene.mesh("shape", frames=FRAMES[:2], times=(0, 24))
    set_range(scene, 0, 24)
    found = frames_of(scene.opened())
    assert len(found) == 25
    np.testing.assert_allclose(found[12, 6:], FRAMES[:2].astype(float).mean(axis=0), atol=1e-6)


def test_samples_at_each_frame_are_the_frames(scene):
    """A range that is longer, or a rate, changes nothing then."""
    set_range(scene, -10, 50)
    for time in range(25):
        scene.turn.Set(time * 7.5, time)
    assert len(scene.opened()) == 25


def test_a_rig_with_few_keys_is_sampled_in_its_range(tmp_path):
    rig = Rig(tmp_path)
    rig.skin()
    rig.animate(times=(1, 11, 21, 31))
    rig.stage.SetStartTimeCode(1)
    rig.stage.SetEndTimeCode(31)
    scene = UsdScene.__new__(UsdScene)
    scene.path, scene.stage = rig.save(), rig.stage
    sequence = scene.opened()
    assert len(sequence) == 31
    frames = frames_of(sequence)
    for k in range(4):
        expected = rigs.expect_linear(k, rigs.POINTS)
        np.testing.assert_allclose(frames[10 * k], expected, rtol=0, atol=2e-6)
    assert np.abs(np.diff(frames, axis=0)).max() < np.abs(np.diff(frames[::10], axis=0)).max() / 5


def test_a_rig_without_a_range_has_a_frame_at_each_sample_and_that_is_said_first(tmp_path):
    rig = Rig(tmp_path)
    rig.skin()
    rig.animate(times=(1, 3, 5, 7))
    scene = UsdScene.__new__(UsdScene)
    scene.path, scene.stage = rig.save(), rig.stage
    sequence = scene.opened()
    assert len(sequence) == 4
    (warning,) = warnings_of(sequence)
    assert "its rig has samples 2 time codes apart" in str(warning)


def test_too_many_frames_are_refused(scene, monkeypatch):
    monkeypatch.setattr("cageik_cli.formats.usd.reader.MAX_TIME_CODES", 25)
    assert len(scene.opened()) == 25
    scene.turn.Set(0, 25)
    assert "keys span 25 frames, expected at most 25; bake it to one" in scene.refused()
    with pytest.raises(FormatError, match="expected at most 10"):
        sample_evenly(0, 1e300, 1e-300, 10)


# --- Alembic


class Turntable(AlembicScene):
    """Transforms whose operations, or matrices, have keys at times in seconds."""

    def __init__(self, folder, fps=None):
        super().__init__(folder)
        if fps is not None:
            self.file = None
            self.objects.clear()
            self.file = CreateArchiveWithInfo(str(self.path), float(fps), "test", "")
            self.objects = {None: self.file.getTop()}

    def turn(self, angles, times, is_matrix=False, axes=None):
        if not isinstance(times, TimeSampling):
            vector = TimeVector()
            vector.extend(times)
            times = TimeSampling(TimeSamplingType(AcyclicFlag.kAcyclic), vector)
        number = self.file.addTimeSampling(times)
        transform = OXform(self.objects[None], "spin", number)
        for k, angle in enumerate(angles):
            sample = XformSample()
            if axes:
                sample.setRotation(imath.V3d(*axes[k]), float(angle))
            elif is_matrix:
                matrix = np.eye(4)
                matrix[:3, :3] = spin(angle).T
                sample.setMatrix(imath.M44d(*map(float, matrix.ravel())))
            else:
                sample.setYRotation(float(angle))
            transform.getSchema().set(sample)
        self.objects["spin"] = transform
        self.mesh(parent="spin", frames=STILL)


@pytest.mark.parametrize("is_matrix", [False, True])
def test_keys_of_an_archive_without_a_rate_are_sampled_and_that_is_said_first(tmp_path, is_matrix):
    archive = Turntable(tmp_path)
    archive.turn([0, 90, 170], TimeSampling(0.5, 0.0), is_matrix)
    sequence = archive.opened()
    angles = np.interp(np.arange(25) / 24, [0, 0.5, 1], [0, 90, 170])
    np.testing.assert_allclose(frames_of(sequence), expect(angles), atol=1e-6)
    assert (sequence.scene.fps, sequence.scene.start) == (24, 0)
    (warning,) = warnings_of(sequence)
    assert str(warning) == (
        "its transforms have 3 keys from 0 to 1 s, and it states no rate: frames are 24 per "
        "second; `fps=` takes another rate"
    )
    sequence = archive.opened(fps=10)
    assert (len(sequence), sequence.scene.fps) == (11, 10)
    assert not warnings_of(sequence)


def test_an_angle_turns_further_than_its_matrices_say(tmp_path):
    archive = Turntable(tmp_path)
    archive.turn([0, 720], [0.0, 1.0])
    np.testing.assert_allclose(
        frames_of(archive.opened()), expect(np.arange(25) * 30), rtol=0, atol=1e-6
    )


def test_the_rate_that_an_archive_states_is_that_of_its_frames(tmp_path):
    archive = Turntable(tmp_path, fps=30)
    archive.turn([0, 90, 180], [0.0, 0.4, 1.0])
    sequence = archive.opened()
    assert (len(sequence), sequence.scene.fps) == (31, 30)
    angles = np.interp(np.arange(31) / 30, [0, 0.4, 1], [0, 90, 180])
    np.testing.assert_allclose(frames_of(sequence), expect(angles), atol=1e-6)


def test_a_rate_that_is_asked_for_is_that_of_the_frames_though_another_is_stated(tmp_path):
    archive = Turntable(tmp_path, fps=24)
    archive.turn([0, 90, 180], [0.0, 0.4, 1.0])
    sequence = archive.opened(fps=12)
    assert (len(sequence), sequence.scene.fps, sequence.scene.frame_step) == (13, 12, None)
    angles = np.interp(np.arange(13) / 12, [0, 0.4, 1], [0, 90, 180])
    np.testing.assert_allclose(frames_of(sequence), expect(angles), atol=1e-6)
    others = archive.opened()
    digests = [each.content_digest(1) for each in (sequence, others, archive.opened(fps=12))]
    assert digests[0] == digests[2] != digests[1]


def test_keys_beside_two_shapes_of_points_are_keys_too(tmp_path):
    archive = Turntable(tmp_path, fps=24)
    archive.turn([0, 90, 180], [0.0, 1.0, 2.0])
    archive.mesh("shape", "spin", frames=FRAMES[:2], times=TimeSampling(1.0, 0.0))
    sequence = archive.opened("::shape")
    assert len(sequence) == 49
    moved = FRAMES[1].astype(float) @ spin(135).T
    np.testing.assert_allclose(sequence.read_frame(36), moved, atol=1e-6)


@pytest.mark.parametrize("keys", [(0.0, 0.31), (-0.1, 1.0)])
def test_frames_are_in_the_steps_of_baked_points_beside_other_keys(tmp_path, keys):
    archive = Turntable(tmp_path)
    archive.turn([0, 90], list(keys))
    archive.mesh("baked", frames=FRAMES[[0, 1, 2, 3, 0, 1]], times=TimeSampling(0.04, 0.0))
    sequence = archive.opened()
    first, last = (-2, 25) if keys[0] else (0, 7)
    assert (len(sequence), sequence.scene.fps) == (last - first + 1, 25)
    angles = np.interp(np.arange(first, last + 1) * 0.04, keys, [0, 90])
    np.testing.assert_allclose(frames_of(sequence)[:, :6], expect(angles), atol=1e-6)
    assert "beside the 6 samples of its points" in " ".join(texts(sequence.notes))


def test_baked_points_far_from_other_keys_or_uneven_keep_their_times(tmp_path):
    archive = Turntable(tmp_path)
    archive.turn([0, 90], [0.0, 1e5])
    archive.mesh("baked", frames=FRAMES, times=TimeSampling(0.04, 0.0))
    assert len(archive.opened()) == 5


@pytest.mark.parametrize("axes", ["xy", "-yy", "zy"])
def test_rotations_about_axes_that_change_are_turned_evenly(tmp_path, axes):
    """As exporters write them that turn the axis when the angle passes half a turn."""
    named = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "-y": (0, -1, 0)}
    archive = Turntable(tmp_path, fps=24)
    archive.turn([0, 120], [0.0, 1.0], axes=[named[axes[:-1]], named[axes[-1]]])
    found = frames_of(archive.opened())
    np.testing.assert_allclose(found, expect(np.arange(25) * 5), atol=1e-6)


def test_transforms_that_are_baked_are_frames(tmp_path):
    archive = Turntable(tmp_path)
    archive.turn(range(0, 130, 10), TimeSampling(1 / 12, 0.5))
    sequence = archive.opened(fps=30)
    assert len(sequence) == 13
    assert not warnings_of(sequence)


def test_a_blend_turns_evenly_stretches_and_mirrors():
    turn, stretch = np.eye(4), np.diag([1.0, 3, 1, 1])
    turn[:3, :3] = spin(120).T
    turn[3, :3] = [4, 0, 0]
    half = blend_transforms(stretch, stretch @ turn, 0.5)
    np.testing.assert_allclose(half[:3, :3], stretch[:3, :3] @ spin(60).T, atol=1e-12)
    np.testing.assert_allclose(half[3, :3], [2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(blend_transforms(stretch, turn, 1.0), turn, atol=1e-12)
    mirror = np.diag([-1.0, 1, 1, 1])
    np.testing.assert_allclose(
        blend_transforms(mirror, mirror @ turn, 0.5)[:3, :3],
        mirror[:3, :3] @ spin(60).T,
        atol=1e-12,
    )
    np.testing.assert_allclose(blend_transforms(np.eye(4), mirror, 0.25), np.diag([0.5, 1, 1, 1]))
    flat = np.diag([1.0, 0, 1, 1])
    np.testing.assert_allclose(blend_transforms(flat, turn, 0.5), (flat + turn) / 2)
