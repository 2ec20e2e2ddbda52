"""The depth buffer against geometry: areas, order, colours, and models that are hardly any."""

import numpy as np
import pytest

from cageik_cli.report.shading import (
    Camera,
    coloured,
    drawn_over,
    lines,
    lit,
    painted,
    rasterised,
    reduced,
    surface_of,
)
from tests.shapes import ball

SIZE = 100
SQUARE = np.array([[0, 1, 2], [0, 2, 3]])


def square(low, high, depth=0.0):
    return np.array(
        [[low, low, depth], [high, low, depth], [high, high, depth], [low, high, depth]]
    )


def test_a_square_covers_its_pixels_once():
    seen = rasterised(square(20.2, 60.7)[SQUARE], SIZE)
    inside = np.zeros((SIZE, SIZE), bool)
    inside[20:61, 20:61] = True  # middles from 20.5 to 60.5
    np.testing.assert_array_equal(seen.face >= 0, inside)
    assert set(seen.depth[inside]) == {0}
    assert np.isinf(seen.depth[~inside]).all()


def test_triangles_that_meet_leave_no_pixel_out():
    """A fan of slivers, around a point, covers its disc without holes."""
    angles = np.linspace(0, 2 * np.pi, 400)
    ring = np.stack([50 + 45 * np.cos(angles), 50 + 45 * np.sin(angles), 0 * angles], axis=1)
    middle = np.broadcast_to([50.1, 49.7, 0.0], ring[1:].shape)
    seen = rasterised(np.stack([middle, ring[:-1], ring[1:]], axis=1), SIZE)
    rows, columns = np.indices((SIZE, SIZE)) + 0.5
    radius = np.hypot(rows - 50, columns - 50)
    assert (seen.face[radius < 44.9] >= 0).all()
    assert (seen.face[radius > 45] == -1).all()


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 2, 1, 0], [2, 0, 3, 1]])
def test_what_is_nearer_hides_what_is_further(order):
    near, far = square(30, 70, -1.0)[SQUARE], square(10, 90, 1.0)[SQUARE]
    seen = rasterised(np.concatenate([near, far])[order], SIZE)
    shown = np.array(order)[seen.face[30:70, 30:70]]
    assert (shown < 2).all()
    assert (seen.depth[30:70, 30:70] == -1).all()
    assert (seen.depth[10:30, 10:90] == 1).all()


def test_triangles_that_cross_are_told_apart_pixel_by_pixel():
    slanted = square(0, SIZE)
    slanted[:, 2] = slanted[:, 0] - 50
    seen = rasterised(np.concatenate([square(0, SIZE)[SQUARE], slanted[SQUARE]]), SIZE)
    assert (seen.face[:, :50] >= 2).all()
    assert (seen.face[:, 50:] < 2).all()
    np.testing.assert_allclose(seen.depth[:, :50] - (np.arange(50) - 49.5), 0, atol=1e-12)


def test_blocks_do_not_show(monkeypatch):
    points = np.random.default_rng(2).uniform(-10, 110, (200, 3, 3))
    whole = rasterised(points, SIZE)
    monkeypatch.setattr("cageik_cli.report.shading.BLOCK", 500)
    blocked = rasterised(points, SIZE)
    np.testing.assert_array_equal(blocked.face, whole.face)
    np.testing.assert_array_equal(blocked.depth, whole.depth)


def test_the_outline_of_a_sphere():
    model = ball(levels=5, size=1.0)
    camera = Camera.fitted(np.eye(3), model.vertices, 400)
    surface = surface_of(camera.project(model.vertices), model.faces, 400)
    assert len(surface.pixels) == pytest.approx(np.pi * (200 * 0.94) ** 2, rel=0.01)
    places = np.stack([surface.pixels % 400, surface.pixels // 400], axis=1) + 0.5
    across = (places - 200) / (200 * 0.94) * (1, -1)
    # A unit sphere's normals are its points.
    np.testing.assert_allclose(surface.normals[:2].T, across, atol=0.05)
    assert (surface.normals[2] >= 0).all()


def test_values_are_interpolated():
    surface = surface_of(square(0, SIZE), SQUARE, SIZE)
    found = surface.interpolated(square(0, SIZE)[:, 0])
    np.testing.assert_allclose(found, surface.pixels % SIZE + 0.5, rtol=1e-12)


def test_flat_faces_have_one_normal_and_both_sides_are_lit():
    corners = np.array([[0.0, 0, 0], [SIZE, 0, SIZE], [SIZE, SIZE, 0], [0, SIZE, SIZE]])
    for faces in (SQUARE, SQUARE[:, ::-1]):
        flat = surface_of(corners, faces, SIZE, is_smooth=False)
        assert len(np.unique(flat.normals.round(12), axis=1)[0]) == 2
        assert (flat.normals[2] > 0).all()
        assert len(np.unique(surface_of(corners, faces, SIZE).normals.round(6), axis=1)[0]) > 100


def test_light_falls_from_above_and_the_left():
    faces = np.array([[0, 1, 0], [0, -1, 0], [-1, 0, 0], [0, 0, 1.0], [-0.42, 0.66, 0.62]])
    up, down, _, front, key = lit(faces.T)
    assert 0 < down < up < key
    assert front < key < 1.1


def test_colours_of_a_scale():
    stops = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0]])
    values = np.array([0, 1, 2, 3, 4, 9, np.nan])
    expected = [[0, 0, 0], [0.5, 0, 0], [1, 0, 0], [1, 0.5, 0], [1, 1, 0], [1, 1, 0], [0, 0, 1]]
    np.testing.assert_allclose(coloured(values, 4, stops, np.array([0, 0, 1.0])), expected)


def test_a_line_is_as_wide_as_asked():
    ends = np.array([[20.0, 50, 3], [80, 50, 5], [50, 20, 1], [50, 20, 1]])
    depth = lines(ends, np.array([[0, 1]]), 4.0, SIZE)
    drawn = np.isfinite(depth)
    assert drawn.sum() == 4 * 64
    assert drawn[48:52, 18:82].all()
    assert np.isfinite(lines(ends, np.array([[2, 3]]), 4.0, SIZE)).sum() == 16


def test_pictures_are_laid_over_and_reduced_by_opacity():
    empty, red = np.zeros((4, 4, 4), np.float32), np.array([1.0, 0, 0])
    opacity = np.zeros((4, 4))
    opacity[0, 0] = 1
    small = reduced(drawn_over(empty, red, opacity))
    assert small.shape == (4, 2, 2)
    np.testing.assert_allclose(small[:, 0, 0], [1, 0, 0, 0.25])
    assert not small[:, 1, 1].any()
    white = np.ones((4, 4, 4), np.float32)
    mixed = drawn_over(white, red, np.full((4, 4), 0.25))
    np.testing.assert_allclose(mixed[:, 0, 0], [1, 0.75, 0.75, 1])
    assert not empty.any()


MODELS = {
    "a point": np.zeros((4, 3)),
    "a line": np.arange(4)[:, None] * np.array([1.0, 2, 3]),
    "seen from its edge": square(0, 1)[:, [2, 0, 1]],
    "huge": 1e30 * square(-1, 1, 0.5),
    "tiny": 1e-30 * square(-1, 1, 0.5),
    "far away": square(-1, 1) + 1e12,
    "one vertex far away": np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [1e30, 1e30, 1e30]]),
    "beside a gap": np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [np.nan] * 3]),
    "nothing": np.full((4, 3), np.nan),
}


@pytest.mark.parametrize("vertices", MODELS.values(), ids=MODELS)
def test_hardly_a_model_is_drawn_all_the_same(vertices):
    camera = Camera.fitted(np.eye(3), vertices, SIZE)
    projected = camera.project(vertices)
    for is_smooth in (True, False):
        surface = surface_of(projected, np.concatenate([SQUARE, [[1, 1, 1]]]), SIZE, is_smooth)
        assert np.isfinite(painted(surface, np.ones(3))).all()
    lines(projected, np.array([[0, 1], [1, 3]]), 3.0, SIZE)


@pytest.mark.parametrize("factor", [1e-30, 1.0, 1e30])
def test_the_scale_does_not_matter(factor):
    vertices = factor * square(-1, 1, 0.5)
    camera = Camera.fitted(np.eye(3), vertices, SIZE)
    surface = surface_of(camera.project(vertices), SQUARE, SIZE)
    assert len(surface.pixels) == 94 * 94
