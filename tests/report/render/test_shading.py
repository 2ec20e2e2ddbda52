"""Shading and colours of models, including degenerate ones."""

import numpy as np
import pytest

from cageik_cli.report.render.model_views import project_surface
from cageik_cli.report.render.raster import ParallelCamera, PerspectiveCamera, rasterize_lines
from cageik_cli.report.render.shading import (
    MESH_COLOURS,
    downsample,
    map_colours,
    overlay,
    parse_colour,
    rasterize_surface,
    render,
    shade,
)
from tests.report.squares import SIZE, SQUARE, square
from tests.shapes import ball


def test_the_outline_of_a_sphere():
    model = ball(levels=5, size=1.0)
    camera = ParallelCamera.fit(np.eye(3), model.vertices, 400)
    surface = rasterize_surface(camera.project(model.vertices), model.faces, 400)
    assert len(surface.pixels) == pytest.approx(np.pi * (200 * 0.94) ** 2, rel=0.01)
    places = np.stack([surface.pixels % 400, surface.pixels // 400], axis=1) + 0.5
    across = (places - 200) / (200 * 0.94) * (1, -1)
    # A unit sphere's normals are its points.
    np.testing.assert_allclose(surface.normals[:2].T, across, atol=0.05)
    assert (surface.normals[2] >= 0).all()


def test_values_are_interpolated():
    surface = rasterize_surface(square(0, SIZE), SQUARE, SIZE)
    found = surface.interpolate(square(0, SIZE)[:, 0])
    np.testing.assert_allclose(found, surface.pixels % SIZE + 0.5, rtol=1e-12)


def test_normals_are_smooth_and_both_sides_are_lit():
    corners = np.array([[0.0, 0, 0], [SIZE, 0, SIZE], [SIZE, SIZE, 0], [0, SIZE, SIZE]])
    for faces in (SQUARE, SQUARE[:, ::-1]):
        normals = rasterize_surface(corners, faces, SIZE).normals
        assert (normals[2] > 0).all()
        assert len(np.unique(normals.round(6), axis=1)[0]) > 100


def test_light_falls_from_above_and_the_left():
    faces = np.array([[0, 1, 0], [0, -1, 0], [-1, 0, 0], [0, 0, 1.0], [-0.42, 0.66, 0.62]])
    up, down, _, front, key = shade(faces.T)
    assert 0 < down < up < key
    assert front < key < 1.1


def test_colours_of_a_scale():
    missing = parse_colour(MESH_COLOURS["missing"])
    values = np.array([0, 1, 2, 3, 4, 9, np.nan])
    expected = [[0, 0, 0], [0.5, 0, 0], [1, 0, 0], [1, 0.5, 0], [1, 1, 0], [1, 1, 0], missing]
    np.testing.assert_allclose(map_colours(values, 4, ("#000000", "#ff0000", "#ffff00")), expected)


def test_pictures_are_laid_over_and_reduced_by_opacity():
    empty, red = np.zeros((4, 4, 4), np.float32), np.array([1.0, 0, 0])
    opacity = np.zeros((4, 4))
    opacity[0, 0] = 1
    small = downsample(overlay(empty, red, opacity))
    assert small.shape == (4, 2, 2)
    np.testing.assert_allclose(small[:, 0, 0], [1, 0, 0, 0.25])
    assert not small[:, 1, 1].any()
    white = np.ones((4, 4, 4), np.float32)
    mixed = overlay(white, red, np.full((4, 4), 0.25))
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
def test_degenerate_models_are_drawn(vertices):
    camera = ParallelCamera.fit(np.eye(3), vertices, SIZE)
    projected = camera.project(vertices)
    surface = rasterize_surface(projected, np.concatenate([SQUARE, [[1, 1, 1]]]), SIZE)
    assert np.isfinite(render(surface, np.ones(3))).all()
    rasterize_lines(projected, np.array([[0, 1], [1, 3]]), 3.0, SIZE)


@pytest.mark.parametrize("factor", [1e-30, 1.0, 1e30])
def test_the_picture_does_not_depend_on_scale(factor):
    vertices = factor * square(-1, 1, 0.5)
    camera = ParallelCamera.fit(np.eye(3), vertices, SIZE)
    surface = rasterize_surface(camera.project(vertices), SQUARE, SIZE)
    assert len(surface.pixels) == 94 * 94


def test_normals_in_a_perspective_are_those_of_the_model():
    """Seen from near, with depths that are squeezed: a unit sphere's normals are its points."""
    model = ball(levels=5, size=1.0)
    camera = PerspectiveCamera(np.eye(3), np.zeros(3), 2.0, 0.01, (200.0, 200.0), 400)
    surface = project_surface(camera, model.vertices, model.faces)
    points = np.stack([surface.interpolate(along) for along in model.vertices.T])
    points /= np.linalg.norm(points, axis=0)
    np.testing.assert_allclose(surface.normals, points, rtol=0, atol=0.05)
    # A ball is seen to where rays touch it: at an angle with the sine 1/2.
    radius = 2.0 * np.tan(np.arcsin(0.5)) / 0.01
    assert len(surface.pixels) == pytest.approx(np.pi * radius**2, rel=0.01)
