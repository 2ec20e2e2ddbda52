"""The bar of time: columns of errors, and where the worst frame is."""

import re
from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.view.player.section import (
    MAX_TIMELINE_COLUMNS,
    MIN_COLUMN_HEIGHT,
    build_timeline,
    draw_columns,
    list_frame_errors,
)

NUMBERS = r"M([\d.]+) 1V([\d.]+)H([\d.]+)V1z"


def read_columns(path):
    """Return left end, height and right end of each column."""
    numbers = np.array(re.findall(NUMBERS, path), float).reshape(-1, 3)
    assert len(numbers) == path.count("M")
    return numbers * [1, -1, 1] + [0, 1, 0]


def test_columns_are_as_high_as_the_errors():
    columns = read_columns(draw_columns(np.array([1.0, 4.0, 0.0, 2.0]))["error"])
    np.testing.assert_allclose(columns[:, 1], [0.25, 1, MIN_COLUMN_HEIGHT, 0.5])
    np.testing.assert_allclose(columns[:, 0], [0, 0.5, 1.5, 2.5])
    np.testing.assert_allclose(columns[:, 2], [0.5, 1.5, 2.5, 3])


def test_skipped_frames_have_full_columns_of_their_own():
    paths = draw_columns(np.array([1.0, np.nan, 2.0]))
    assert len(read_columns(paths["error"])) == 2
    np.testing.assert_allclose(read_columns(paths["skipped"]), [[0.5, 1, 1.5]])


@pytest.mark.parametrize("errors", [np.zeros(3), np.full(3, np.nan)])
def test_a_clip_without_any_error_has_its_columns(errors):
    assert sum(path.count("M") for path in draw_columns(errors).values()) == 3


def test_frames_of_a_long_clip_share_columns():
    errors = np.ones(5 * MAX_TIMELINE_COLUMNS)
    errors[7] = 10.0
    columns = read_columns(draw_columns(errors)["error"])
    assert len(columns) == MAX_TIMELINE_COLUMNS
    np.testing.assert_allclose(columns[:3, 1], [0.1, 1, 0.1])


def test_ticks_and_jumps_are_the_held_frames(clip):
    timeline = build_timeline(clip)
    assert timeline["last"] == len(clip.frames) - 1
    assert [label for label, _ in timeline["ticks"]] == [label for label, _ in clip.held.values()]
    assert [frame for frame, _ in timeline["jumps"]] == list(clip.held)
    places = [place for _, place in timeline["ticks"]]
    np.testing.assert_allclose(places, [100 * one / timeline["last"] for one in clip.held])


def test_a_single_pose_has_an_empty_bar(clip):
    pose = replace(clip, frames=(), frame_rms=None, held={})
    assert build_timeline(pose) == {"last": 0, "paths": {}, "ticks": [], "jumps": []}
    assert list_frame_errors(pose) is None
