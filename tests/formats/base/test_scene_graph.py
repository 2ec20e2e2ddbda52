"""Polygons and transforms of scenes, and readers that are tried."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from cageik_cli.formats.base import scene_graph
from cageik_cli.formats.base.scene_graph import (
    EVEN_STEP_TOL,
    LibraryError,
    check_corner_counts,
    find_step,
    read_constant_polygons,
    transform_points,
    try_scene,
)
from cageik_cli.util.errors import ConnectivityError, FormatError

COUNTS, CORNERS = np.array([3, 4]), np.array([0, 1, 2, 1, 2, 3, 4])


@pytest.mark.parametrize("counts", [[], [3], [3, 5], [-3, 10], [2**62, 2**62]])
def test_counts_that_do_not_fit_the_corners_are_refused(counts):
    with pytest.raises(FormatError, match="corners, found 7"):
        check_corner_counts(np.array(counts, np.int64), CORNERS)


@pytest.mark.parametrize(
    "others", [(np.array([4, 3]), CORNERS), (COUNTS, CORNERS[::-1]), (COUNTS, CORNERS[:6])]
)
def test_polygons_differ_by_counts_or_corners(others):
    polygons = {0: (COUNTS, CORNERS), 1: (COUNTS.copy(), CORNERS.copy()), 2.5: others}
    assert read_constant_polygons(polygons.__getitem__, [0, 1]) == polygons[0]
    with pytest.raises(ConnectivityError, match="faces change at time 2"):
        read_constant_polygons(polygons.__getitem__, [0, 1, 2.5])


@pytest.mark.parametrize(
    ("times", "step"),
    [
        ([0.0], None),
        ([1.0, 2.0, 3.0], 1.0),
        ([-1.5, 0.0, 1.5], 1.5),
        ([1.0, 2.0, 4.0], None),
        ([0.0, 1.0, 2.0 + 4 * EVEN_STEP_TOL], None),
        ([0.0, 1.0, 2.0 + EVEN_STEP_TOL / 4], 1 + EVEN_STEP_TOL / 8),
    ],
)
def test_samples_have_one_step_or_none(times, step):
    assert find_step(np.array(times)) == step


@pytest.mark.parametrize("fps", [24, 25, 29.97, 120])
def test_the_step_of_times_counted_up_from_far(fps):
    assert 1 / find_step(86400 + np.arange(2000) / fps) == pytest.approx(fps, rel=1e-8)


def test_what_is_not_moved_keeps_every_bit():
    tiny = np.array([[1e-300, -0.0, 1e300]])
    np.testing.assert_array_equal(transform_points(tiny, np.eye(4)), tiny)


@pytest.fixture
def try_reader(monkeypatch, tmp_path):
    """Try a reader of five frames; return what it says, and the frames that were read."""
    path, frames = tmp_path / "clip.abc", []
    path.write_bytes(b"abc")

    class Reader:
        def __init__(self, request):
            if "locked" in request.settings.exclude:
                raise LibraryError(f"{request.path}: is locked")

        def __len__(self):
            return 5

        def read_positions(self, index):
            if index == 4:
                raise FormatError("frame 4 is damaged")
            frames.append(index)

    monkeypatch.setitem(sys.modules, "tried", SimpleNamespace(Reader=Reader))
    return lambda *exclude: (try_scene("tried", str(path), None, list(exclude)), frames)


def test_what_a_library_says_of_the_first_frame_is_returned(try_reader):
    assert try_reader("locked") == ("is locked", [])


def test_all_frames_are_tried_and_faults_of_later_ones_left_to_who_reads_them(try_reader):
    with pytest.raises(FormatError, match="frame 4"):
        try_reader()


def test_frames_that_take_too_long_are_not_tried(try_reader, monkeypatch):
    monkeypatch.setattr(scene_graph, "MAX_TRIED_SECONDS", -1.0)
    assert try_reader() == (None, [])
