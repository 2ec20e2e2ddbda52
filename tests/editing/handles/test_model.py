"""Motions from what they are by definition, and screens by another computation."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cageik_cli.editing.handles.model import Motion
from cageik_cli.method.pose.camera import Camera
from tests.method.pose.test_camera import stand

FRAMES = np.arange(12)
KEYS = np.array([2, 5, 9])
VALUES = np.array([[1.0, 2, 3], [2, 0, 3], [2.5, 1, 3]])
POSITIONS = np.random.default_rng(5).normal(0, 0.5, (12, 3))

STANDING = stand(np.array([1.0, 2, 9]), np.zeros(3), np.array([0.0, 1, 0]), width=640, height=480)
_PARALLEL = np.diag([0.3, 0.4, -0.05, 1.0])
PARALLEL = Camera(STANDING.view, _PARALLEL, 640, 480)
_FAR = np.array([[1.2, 0, 0.1, 0], [0, 1.6, 0.05, 0], [0, 0, -1.02, -0.2], [0, 0, -1, 0]])
LOPSIDED = Camera(STANDING.view, _FAR, 640, 480)
CAMERAS = pytest.mark.parametrize(
    "camera", [STANDING, PARALLEL, LOPSIDED], ids=["standing", "parallel", "lopsided"]
)


@pytest.mark.parametrize("keys", [None, KEYS[:1]])
def test_one_value_is_constant(keys):
    found = Motion("target", VALUES[:1], keys).evaluate(FRAMES)
    np.testing.assert_array_equal(found, np.tile(VALUES[0], (12, 1)))


def test_keys_are_met_and_the_ends_are_constant():
    found = Motion("target", VALUES, KEYS).evaluate(FRAMES)
    np.testing.assert_array_equal(found[KEYS], VALUES)
    np.testing.assert_array_equal(found[:2], np.tile(VALUES[0], (2, 1)))
    np.testing.assert_array_equal(found[10:], np.tile(VALUES[2], (2, 1)))


def test_equal_keys_are_linear_between_steps_of_a_line():
    """A monotone cubic has the line's slope at the keys of a line, and so is the line."""
    frames = np.array([0, 4, 8, 11])
    line, expected = (k[:, None] * np.array([[0.5, -2.0, 0.0]]) + 1 for k in (frames, FRAMES))
    found = Motion("target", line, frames).evaluate(FRAMES)
    np.testing.assert_allclose(found, expected, rtol=1e-13)


@given(
    values=st.lists(st.floats(-1e50, 1e50), min_size=2, max_size=6),
    gaps=st.lists(st.integers(1, 9), min_size=6, max_size=6),
)
@example(values=[0.0, 0.0, 2.2250738585e-313], gaps=[1, 3, 2, 1, 1, 1])
def test_keyframes_do_not_overshoot(values, gaps):
    keys = np.cumsum(gaps)[: len(values)]
    frames = np.arange(keys[0], keys[-1] + 1)
    found = Motion("target", np.array(values)[:, None], keys).evaluate(frames)[:, 0]
    place = np.searchsorted(keys, frames, side="right") - 1
    after = np.minimum(place + 1, len(values) - 1)
    ends = np.sort([np.array(values)[place], np.array(values)[after]], axis=0)
    # Below the smallest normal number, rounding is no share of the values.
    slack = 1e-14 * np.abs(values).max() + np.finfo(float).tiny
    assert (found >= ends[0] - slack).all()
    assert (found <= ends[1] + slack).all()


def unprojected(camera: Camera, position: np.ndarray, pixel: np.ndarray) -> np.ndarray:
    """The point in a pixel at the depth before the eye of a position, by its equations.

    Its three coordinates solve: it is in the pixel's column, in its row, and its depth before the
    eye is the position's.
    """
    both = camera.projection @ camera.view
    x, y = 2 * pixel[0] / camera.width - 1, 1 - 2 * pixel[1] / camera.height
    rows = np.stack([both[0] - x * both[3], both[1] - y * both[3], camera.view[2]])
    depth = camera.view[2] @ [*position, 1]
    return np.linalg.solve(rows[:, :3], np.array([0, 0, depth]) - rows[:, 3])


@CAMERAS
def test_a_screen_target_keeps_the_depth(camera):
    pixels = np.linspace([100, 400], [500, 50], 12)
    found = Motion("screen.target", pixels, FRAMES, camera).targets(FRAMES, POSITIONS)
    expected = [unprojected(camera, p, q) for p, q in zip(POSITIONS, pixels, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    # A pixel is some hundredths of a unit there.
    np.testing.assert_allclose(camera.project(found)[:, :2], pixels, rtol=0, atol=1e-7)


@CAMERAS
def test_a_screen_offset_is_relative_to_each_frame(camera):
    offset = np.array([30.0, -12.5])
    found = Motion("screen.offset", offset[None], camera=camera).targets(FRAMES, POSITIONS)
    pixels = camera.project(POSITIONS)[:, :2] + offset
    expected = [unprojected(camera, p, q) for p, q in zip(POSITIONS, pixels, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


def test_pixels_downwards_are_down():
    found = Motion("screen.offset", np.array([[0.0, 10.0]]), camera=STANDING).targets(
        FRAMES, POSITIONS
    )
    assert ((found - POSITIONS)[:, 1] < 0).all()


def test_values_ease_from_key_to_key_as_is_said():
    keys, values = np.array([2.0, 6.0, 10.0]), np.array([[0.0], [4.0], [2.0]])
    found = {
        ease: Motion("offset", values, keys, ease=ease).evaluate(FRAMES)[:, 0]
        for ease in ("smooth", "linear", "stepped")
    }
    np.testing.assert_array_equal(found["linear"], [0, 0, 0, 1, 2, 3, 4, 3.5, 3, 2.5, 2, 2])
    np.testing.assert_array_equal(found["stepped"], [0, 0, 0, 0, 0, 0, 4, 4, 4, 4, 2, 2])
    for one in found.values():
        np.testing.assert_array_equal(one[[2, 6, 10]], [0, 4, 2])
    assert abs(found["smooth"][3] - 1) > 0.1


def test_an_offset_turns_with_the_surface():
    turns = np.stack([np.eye(3), [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]])
    motion = Motion("offset", np.array([[1.0, 0, 0]]), turns=True)
    found = motion.targets(np.arange(2), np.zeros((2, 3)), turns)
    np.testing.assert_array_equal(found, [[1, 0, 0], [0, 1, 0]])
