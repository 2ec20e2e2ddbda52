"""The depth buffer against geometry: areas and order."""

from functools import partial

import numpy as np
import pytest

from cageik_cli.report.render import raster
from cageik_cli.report.render.raster import (
    ParallelCamera,
    PerspectiveCamera,
    rasterize,
    rasterize_lines,
)
from cageik_cli.util import compiled
from tests.report.squares import SIZE, SQUARE, square


def test_a_square_covers_its_pixels_once(core):
    face, depth = rasterize(square(20.2, 60.7)[SQUARE], SIZE)
    inside = np.zeros((SIZE, SIZE), bool)
    inside[20:61, 20:61] = True  # middles from 20.5 to 60.5
    np.testing.assert_array_equal(face >= 0, inside)
    assert set(depth[inside]) == {0}
    assert np.isinf(depth[~inside]).all()


def test_adjacent_triangles_leave_no_gap(core):
    """A fan of thin triangles around a point covers its disc without holes."""
    angles = np.linspace(0, 2 * np.pi, 400)
    ring = np.stack([50 + 45 * np.cos(angles), 50 + 45 * np.sin(angles), 0 * angles], axis=1)
    middle = np.broadcast_to([50.1, 49.7, 0.0], ring[1:].shape)
    face, _ = rasterize(np.stack([middle, ring[:-1], ring[1:]], axis=1), SIZE)
    rows, columns = np.indices((SIZE, SIZE)) + 0.5
    radius = np.hypot(rows - 50, columns - 50)
    assert (face[radius < 44.9] >= 0).all()
    assert (face[radius > 45] == -1).all()


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 2, 1, 0], [2, 0, 3, 1]])
def test_near_triangles_hide_far_ones(core, order):
    near, far = square(30, 70, -1.0)[SQUARE], square(10, 90, 1.0)[SQUARE]
    face, depth = rasterize(np.concatenate([near, far])[order], SIZE)
    shown = np.array(order)[face[30:70, 30:70]]
    assert (shown < 2).all()
    assert (depth[30:70, 30:70] == -1).all()
    assert (depth[10:30, 10:90] == 1).all()


def test_crossing_triangles_are_resolved_per_pixel(core):
    slanted = square(0, SIZE)
    slanted[:, 2] = slanted[:, 0] - 50
    face, depth = rasterize(np.concatenate([square(0, SIZE)[SQUARE], slanted[SQUARE]]), SIZE)
    assert (face[:, :50] >= 2).all()
    assert (face[:, 50:] < 2).all()
    np.testing.assert_allclose(depth[:, :50] - (np.arange(50) - 49.5), 0, atol=1e-12)


def test_blocks_do_not_change_the_picture(monkeypatch):
    monkeypatch.setattr(compiled, "kernel", None)
    points = np.random.default_rng(2).uniform(-10, 110, (200, 3, 3))
    whole = rasterize(points, SIZE)
    monkeypatch.setattr(raster, "_split_blocks", partial(raster._split_blocks, pixels=500))
    blocked = rasterize(points, SIZE)
    np.testing.assert_equal(blocked, whole)


def test_a_line_has_its_width(core):
    ends = np.array([[20.0, 50, 3], [80, 50, 5], [50, 20, 1], [50, 20, 1]])
    depth = rasterize_lines(ends, np.array([[0, 1]]), 4.0, SIZE)
    drawn = np.isfinite(depth)
    assert drawn.sum() == 4 * 64
    assert drawn[48:52, 18:82].all()
    assert np.isfinite(rasterize_lines(ends, np.array([[2, 3]]), 4.0, SIZE)).sum() == 16


def hard_triangles():
    """Triangles that are large, thin, without area, equally near, outside or not finite."""
    generator = np.random.default_rng(4)
    middles = generator.uniform(-20, 120, (600, 1, 3))
    triangles = middles + generator.normal(size=(600, 3, 3)) * generator.choice(
        [1, 9, 50], (600, 1, 1)
    )
    triangles[200:400] = np.round(2 * triangles[200:400]) / 2
    triangles[400:420, 2] = triangles[400:420, 1]
    triangles[420:440] = triangles[420:440, :1]
    triangles[440:480, 1] = 0.5 * (triangles[440:480, 0] + triangles[440:480, 2])
    triangles[480:500] = triangles[100:120]
    triangles[500:510, 1, 2], triangles[510:520, 0, 0] = np.nan, np.inf
    return triangles


def test_the_compiled_body_draws_the_same_pixels(monkeypatch):
    if compiled.kernel is None:
        pytest.skip("the core was not compiled")
    found = rasterize(hard_triangles(), SIZE)
    monkeypatch.setattr(compiled, "kernel", None)
    expected = rasterize(hard_triangles(), SIZE)
    np.testing.assert_equal(found, expected)
    assert len(np.unique(found[0])) > 20


def test_the_compiled_body_refuses_what_does_not_fit():
    kernel = compiled.kernel
    if kernel is None:
        pytest.skip("the core was not compiled")
    corners, face, depth = np.zeros((1, 3, 3)), np.zeros((4, 4), np.int64), np.zeros((4, 4))
    with pytest.raises(ValueError, match="face: expected a square"):
        kernel.draw_triangles(corners, face[1:], depth)
    with pytest.raises(ValueError, match="depth: length 3"):
        kernel.draw_triangles(corners, face, depth[1:])
    with pytest.raises(TypeError, match="corners: expected an array of float64"):
        kernel.draw_triangles(corners.astype(np.float32), face, depth)


def make_perspective(distance):
    centre = np.array([1.0, 2.0, 3.0])
    return PerspectiveCamera(np.eye(3), centre, distance, 0.1, (30.0, 50.0), SIZE)


def test_far_away_a_perspective_is_parallel():
    points = np.random.default_rng(3).uniform(-2, 2, (50, 3)) + np.array([1, 2, 3])
    parallel = ParallelCamera(np.eye(3), np.array([1.0, 2.0, 3.0]), 5.0, 100).project(points)
    found = make_perspective(1e9).project(points) + np.array([20, 0, 0])
    np.testing.assert_allclose(found, parallel, rtol=0, atol=1e-5)


def test_a_perspective_is_that_of_similar_triangles():
    camera = make_perspective(10.0)
    found = camera.project(np.array([[2.0, 2, 3], [2.0, 2, 8], [1.0, 3, -7]]))
    np.testing.assert_allclose(found[:, :2], [[40, 50], [50, 50], [30, 45]], rtol=1e-12)
    assert (np.diff(found[[1, 0, 2], 2]) > 0).all()


def test_what_is_near_or_behind_a_perspective_camera_has_no_place():
    found = make_perspective(10.0).project(np.array([[1.0, 2, 12.7], [1.0, 2, 12.9], [0, 0, 20]]))
    assert np.isfinite(found[0]).all()
    assert np.isnan(found[1:]).all()


def test_depths_of_a_perspective_are_in_planes():
    """Those of points of a segment are in the ratio of their places."""
    ends = np.array([[0.0, 0, 0], [3.0, 1, 8]])
    shares = np.linspace(0, 1, 7)[:, None]
    found = make_perspective(10.0).project(ends[0] + shares * (ends[1] - ends[0]))
    along = (found - found[0]) / (found[-1] - found[0])
    np.testing.assert_allclose(along[:, 2], along[:, 0], rtol=0, atol=1e-12)
