"""The depth buffer against geometry: areas and order."""

import numpy as np
import pytest

from cageik_cli.report.render.raster import rasterize, rasterize_lines
from tests.report.squares import SIZE, SQUARE, square


def test_a_square_covers_its_pixels_once():
    seen = rasterize(square(20.2, 60.7)[SQUARE], SIZE)
    inside = np.zeros((SIZE, SIZE), bool)
    inside[20:61, 20:61] = True  # middles from 20.5 to 60.5
    np.testing.assert_array_equal(seen.face >= 0, inside)
    assert set(seen.depth[inside]) == {0}
    assert np.isinf(seen.depth[~inside]).all()


def test_adjacent_triangles_leave_no_gap():
    """A fan of thin triangles around a point covers its disc without holes."""
    angles = np.linspace(0, 2 * np.pi, 400)
    ring = np.stack([50 + 45 * np.cos(angles), 50 + 45 * np.sin(angles), 0 * angles], axis=1)
    middle = np.broadcast_to([50.1, 49.7, 0.0], ring[1:].shape)
    seen = rasterize(np.stack([middle, ring[:-1], ring[1:]], axis=1), SIZE)
    rows, columns = np.indices((SIZE, SIZE)) + 0.5
    radius = np.hypot(rows - 50, columns - 50)
    assert (seen.face[radius < 44.9] >= 0).all()
    assert (seen.face[radius > 45] == -1).all()


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 2, 1, 0], [2, 0, 3, 1]])
def test_near_triangles_hide_far_ones(order):
    near, far = square(30, 70, -1.0)[SQUARE], square(10, 90, 1.0)[SQUARE]
    seen = rasterize(np.concatenate([near, far])[order], SIZE)
    shown = np.array(order)[seen.face[30:70, 30:70]]
    assert (shown < 2).all()
    assert (seen.depth[30:70, 30:70] == -1).all()
    assert (seen.depth[10:30, 10:90] == 1).all()


def test_crossing_triangles_are_resolved_per_pixel():
    slanted = square(0, SIZE)
    slanted[:, 2] = slanted[:, 0] - 50
    seen = rasterize(np.concatenate([square(0, SIZE)[SQUARE], slanted[SQUARE]]), SIZE)
    assert (seen.face[:, :50] >= 2).all()
    assert (seen.face[:, 50:] < 2).all()
    np.testing.assert_allclose(seen.depth[:, :50] - (np.arange(50) - 49.5), 0, atol=1e-12)


def test_blocks_do_not_change_the_picture(monkeypatch):
    points = np.random.default_rng(2).uniform(-10, 110, (200, 3, 3))
    whole = rasterize(points, SIZE)
    monkeypatch.setattr("cageik_cli.report.render.raster.BLOCK_PIXELS", 500)
    blocked = rasterize(points, SIZE)
    np.testing.assert_array_equal(blocked.face, whole.face)
    np.testing.assert_array_equal(blocked.depth, whole.depth)


def test_a_line_has_its_width():
    ends = np.array([[20.0, 50, 3], [80, 50, 5], [50, 20, 1], [50, 20, 1]])
    depth = rasterize_lines(ends, np.array([[0, 1]]), 4.0, SIZE)
    drawn = np.isfinite(depth)
    assert drawn.sum() == 4 * 64
    assert drawn[48:52, 18:82].all()
    assert np.isfinite(rasterize_lines(ends, np.array([[2, 3]]), 4.0, SIZE)).sum() == 16
