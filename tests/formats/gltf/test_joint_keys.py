"""Keys of joints: few of them give all frames within what is allowed."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from cageik_cli.formats.gltf.skeleton import (
    ROTATION,
    TRANSLATION,
    JointKeys,
    Track,
    interpolate_turns,
    reduce_track,
    round_track,
)

RANDOM = np.random.default_rng(3)
TIMES = np.arange(60)
CURVE = np.stack([np.sin(TIMES / 20), np.cos(TIMES / 15), TIMES / 60], axis=1)
TURNS = Rotation.from_rotvec(np.outer(np.sin(TIMES / 9) * 2, [0.48, 0.6, 0.64])).as_quat()


def angles(first, second):
    return (Rotation.from_quat(first).inv() * Rotation.from_quat(second)).magnitude()


@pytest.mark.parametrize("allowed", [1e-3, 1e-2, 0.1])
def test_translations_are_within_what_is_allowed(allowed):
    track = reduce_track(TRANSLATION, 0, CURVE, allowed)
    found = track.evaluate(0, 60)
    assert np.linalg.norm(found - CURVE, axis=1).max() <= allowed
    np.testing.assert_array_equal(found[track.frames], CURVE[track.frames])
    assert (len(track.frames) < 20) == (allowed > 1e-3)


@pytest.mark.parametrize("allowed", [1e-2, 0.1])
def test_rotations_are_within_what_is_allowed(allowed):
    track = reduce_track(ROTATION, 0, TURNS, allowed)
    assert angles(track.evaluate(0, 60), TURNS).max() <= allowed * (1 + 1e-9)
    assert len(track.frames) < 40


def test_a_line_has_two_keys_and_a_joint_at_rest_has_one():
    line = np.outer(TIMES, [1.0, 2, 3])
    np.testing.assert_array_equal(reduce_track(TRANSLATION, 0, line, 1e-9).frames, [0, 59])
    still = np.tile([1.0, 2, 3], (60, 1))
    track = reduce_track(TRANSLATION, 0, still, 0)
    np.testing.assert_array_equal(track.frames, [0])
    np.testing.assert_array_equal(track.evaluate(5, 8), still[:3])
    turned = np.tile(TURNS[7], (60, 1)) * np.where(TIMES % 2, 1, -1)[:, None]
    np.testing.assert_array_equal(reduce_track(ROTATION, 0, turned, 1e-7).frames, [0])


def test_noise_keeps_all_keys_which_share_their_times():
    noise = RANDOM.normal(size=(60, 3))
    np.testing.assert_array_equal(reduce_track(TRANSLATION, 0, noise, 1e-3).frames, TIMES)


def test_two_frames_and_one_have_their_keys():
    for count in (1, 2):
        track = reduce_track(TRANSLATION, 0, CURVE[:count], 0)
        np.testing.assert_array_equal(track.evaluate(0, count), CURVE[:count])


def test_rotations_between_keys_turn_evenly_the_short_way():
    shares = np.linspace(0, 1, 11)
    for end in (TURNS[20], -TURNS[20], TURNS[0], -TURNS[0]):
        ends = [np.tile(each, (11, 1)) for each in (TURNS[0], end)]
        found = interpolate_turns(*ends, shares)
        expected = Slerp([0, 1], Rotation.from_quat([TURNS[0], end]))(shares).as_quat()
        assert angles(found, expected).max() < 1e-7


def test_rounded_rotations_are_those_of_16_bits():
    found = round_track(Track(ROTATION, 0, TIMES, TURNS)).values
    np.testing.assert_allclose(found * 32767, np.rint(TURNS * 32767), atol=1e-9)
    moves = Track(TRANSLATION, 0, TIMES, CURVE)
    assert round_track(moves) is moves


def test_frames_and_tracks_are_what_was_kept(tmp_path):
    keys = JointKeys(tmp_path, 2, 1)
    places = RANDOM.normal(size=(4, 2, 3)).astype(np.float32)
    turns = RANDOM.normal(size=(4, 1, 4)).astype(np.float32)
    for each in zip(places, turns, strict=True):
        keys.append(*each)
    moved, turned = keys.read_frames(1, 3)
    np.testing.assert_array_equal(moved, places[1:3])
    np.testing.assert_array_equal(turned, turns[1:3])
    found = {(path, joint): values for path, joint, values in keys.read_tracks()}
    assert set(found) == {(TRANSLATION, 0), (TRANSLATION, 1), (ROTATION, 0)}
    np.testing.assert_array_equal(found[TRANSLATION, 1], places[:, 1])
    np.testing.assert_array_equal(found[ROTATION, 0], turns[:, 0])
    keys.close()
    assert list(tmp_path.iterdir()) == []
