"""Time and space of an animation: who says what, and what cannot be."""

import numpy as np
import pytest

from cageik_cli.formats.settings import Scene, SceneHints, find_frame_step, parse_scene_metadata
from cageik_cli.util.errors import SettingError


def test_what_is_said_stands_and_the_rest_is_usual():
    said = SceneHints(fps=30.0, up_axis="Z")
    assert said.override(Scene(start=5.0)) == Scene(30.0, 5.0, "Z", 1.0)
    assert SceneHints().override(Scene(25.0)) == Scene(25.0)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"fps": 0.0}, "0 frames"),
        ({"fps": float("nan")}, "nan frames"),
        ({"metres_per_unit": -1.0}, "-1 metres"),
        ({"metres_per_unit": float("inf")}, "inf metres"),
        ({"start": float("inf")}, "first frame is inf"),
        ({"start": -1e300}, r"first frame is -1e\+300, expected one up to 1e\+50"),
        ({"fps": 1e308}, r"1e\+308 frames per second, expected 1e-50 to 1e\+50"),
        ({"fps": 1e-308}, r"1e-308 frames per second, expected 1e-50 to"),
        ({"metres_per_unit": 1e51}, r"1e\+51 metres per unit, expected 1e-50 to"),
        ({"frame_step": 1.7e308}, r"1\.7e\+308 as the step of frame numbers, expected 1e-50 to"),
        ({"frame_step": 0.0}, "0 as the step of frame numbers"),
        ({"frame_step": -1.0}, "-1 as the step"),
        ({"frame_step": float("nan")}, "nan as the step"),
        ({"up_axis": "X"}, r"up.axis.* is .?X.?, expected .*Y\W.*Z"),
    ],
)
@pytest.mark.parametrize("kind", [Scene, SceneHints])
def test_what_cannot_be_is_refused(kind, wrong, says):
    with pytest.raises(SettingError, match=says):
        kind(**wrong)


def test_extreme_numbers_of_a_scene_do_not_overflow():
    for number in (1e50, 1e-50):
        scene = Scene(fps=number, start=1e50, metres_per_unit=number, frame_step=number)
        assert np.isfinite(scene.frame_number(10**9) / scene.fps / scene.metres_per_unit)


def test_part_of_a_clip_keeps_its_place_and_speed():
    hints = SceneHints(fps=24.0, start=1001.0)
    chosen = SceneHints(fps=24.0, start=1011.0, frame_step=2.0)
    assert hints.restrict_to_frames(range(10, 20, 2)) == chosen
    again = SceneHints(fps=24.0, start=1015.0, frame_step=6.0)
    assert chosen.restrict_to_frames(range(2, 5, 3)) == again
    assert hints.restrict_to_frames(range(4)) == hints


def test_part_of_a_clip_without_numbers_counts_from_one():
    chosen = SceneHints(up_axis="Z").restrict_to_frames(range(4, 8, 3))
    assert chosen == SceneHints(start=5.0, up_axis="Z", frame_step=3.0)
    assert SceneHints().restrict_to_frames(range(0, 8, 2)) == SceneHints(frame_step=2.0)


def test_frames_have_numbers():
    scene = Scene(start=1001, frame_step=2)
    assert [scene.frame_number(k) for k in range(3)] == [1001, 1003, 1005]


@pytest.mark.parametrize(
    ("start", "step"),
    [(0, None), (42, None), (500.5, 2), (333 + 2 / 3, 3), (0.3, 10), (0.33, None)],
)
def test_the_step_is_found_from_the_time_of_the_first_frame(start, step):
    assert find_frame_step(start, 1e-6) == step


def test_only_what_is_sound_of_a_files_words_is_taken():
    said = {"fps": np.float32(30), "start": np.int64(-2), "up_axis": "Z", "metres_per_unit": 0.01}
    assert parse_scene_metadata(said) == (SceneHints(30.0, -2.0, "Z", 0.01), ())
    assert parse_scene_metadata({}) == (SceneHints(), ())
    others = {"fps": [30.0], "start": "first", "up_axis": 1, "metres_per_unit": object()}
    assert parse_scene_metadata(others) == (SceneHints(), ())


@pytest.mark.parametrize(
    ("name", "value"),
    [("fps", 0), ("fps", np.nan), ("start", np.inf), ("up_axis", "X"), ("metres_per_unit", -1)],
)
def test_what_cannot_be_is_passed_by_with_a_note(name, value):
    hints, (note,) = parse_scene_metadata({name: value})
    assert hints == SceneHints()
    assert note.startswith(f"ignored `{name}`: ")


def test_hints_in_words():
    assert SceneHints().description == ""
    assert SceneHints(start=0).description == "from frame 0"
    stepped = SceneHints(start=1001, frame_step=2)
    assert stepped.description == "from frame 1001, in steps of 2"
    words = "23.976 frames per second, from frame 1, Z up, 0.01 m per unit"
    assert SceneHints(23.976, 1.0, "Z", 0.01).description == words
