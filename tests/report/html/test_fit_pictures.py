"""Fitted weights beside those before the fit: the meshes that are drawn, and their pictures."""

import io
from dataclasses import replace

import h5py
import numpy as np
import pytest
from PIL import Image

from cageik_cli.report.html.fit_section import load_fit_shapes, render_fit_pictures
from cageik_cli.report.render.model_views import load_poses
from cageik_cli.store.result import read_binding

PIXELS = 60


@pytest.fixture(scope="module")
def poses(fitted):
    return load_poses(fitted)


@pytest.fixture(scope="module")
def shapes(fitted, poses):
    return load_fit_shapes(fitted, poses)


@pytest.fixture(scope="module")
def pictures(poses, shapes):
    return render_fit_pictures(poses, shapes, PIXELS)


def open_png(content):
    return np.asarray(Image.open(io.BytesIO(content)), float)


def tint(content):
    """How much more red than blue each visible pixel is."""
    pixels = open_png(content)
    return (pixels[..., 0] - pixels[..., 2])[pixels[..., 3] > 0]


def test_a_frame_differs_from_its_unfitted_mesh_by_what_is_kept(fitted, shapes):
    assert [fitted.label for _, fitted in shapes.poses] == ["worst", "median"]
    with h5py.File(fitted.path) as file:
        numbers, rms = file["unfitted/frame"][:].tolist(), file["unfitted/rms"][:]
    for one, _ in shapes.poses:
        misses = np.linalg.norm(one.original - one.reconstruction, axis=1)
        expected = rms[numbers.index(fitted.frames.index(one.name))]
        assert abs(np.sqrt(np.mean(misses**2)) - expected) < 1e-6
        percent = 100 * misses / fitted.rest.diagonal
        np.testing.assert_allclose(one.deviation, percent, rtol=0, atol=1e-5)


def test_a_cage_vertex_is_moved_outward_by_a_twentieth_of_the_diagonal(fitted, shapes):
    moved, cage = shapes, fitted.cage.vertices
    assert abs(np.linalg.norm(moved.move) / fitted.rest.diagonal - 0.05) < 1e-12
    assert moved.move @ (cage[moved.vertex] - cage.mean(axis=0)) > 0
    assert (moved.cage_faces == moved.vertex).any(axis=1).all()
    weights = read_binding(fitted).weights
    np.testing.assert_array_equal(moved.fitted, weights[:, moved.vertex])
    assert np.abs(moved.fitted - moved.unfitted).max() > 1e-3


def test_the_pictures_and_their_scales(pictures, shapes):
    assert [one.label for one in pictures.poses] == ["worst", "median"]
    assert len(pictures.moved) == 3
    assert all("original" in one.files for one in pictures.poses)
    assert all("original" not in one.files for one in pictures.moved)
    for one in (*pictures.poses, *pictures.moved):
        for content in one.files.values():
            assert open_png(content).shape == (PIXELS, PIXELS, 4)
        assert one.files["unfitted"] != one.files["fitted"]
    for weights, held in (
        (shapes.unfitted, pictures.unfitted_range),
        (shapes.fitted, pictures.fitted_range),
    ):
        np.testing.assert_allclose(held, (5 * weights.min(), 5 * weights.max()))
    assert pictures.vertex == shapes.vertex


def test_the_same_result_gives_the_same_pictures(poses, shapes, pictures):
    assert render_fit_pictures(poses, shapes, PIXELS) == pictures


def test_what_moves_against_the_vertex_is_blue(poses, shapes):
    m = len(shapes.fitted)
    opposite = replace(shapes, unfitted=np.full(m, 0.4), fitted=np.full(m, -0.4))
    pictures = render_fit_pictures(poses, opposite, PIXELS)
    assert pictures.fitted_range == (-2.0, -2.0)
    for one in pictures.moved:
        assert np.median(tint(one.files["unfitted"])) > 20
        assert np.median(tint(one.files["fitted"])) < -20


def test_weights_that_are_all_zero_are_drawn(poses, shapes):
    nothing = np.zeros(len(shapes.fitted))
    still = replace(shapes, unfitted=nothing, fitted=nothing)
    pictures = render_fit_pictures(poses, still, PIXELS)
    assert pictures.max_move_percent == 0.001


def test_missing_data_is_grey(poses, shapes):
    missing = replace(poses, vertex_rms=np.full(len(poses.vertex_rms), np.nan))
    pictures = render_fit_pictures(missing, shapes, PIXELS)
    assert abs(np.median(tint(pictures.poses[0].files["fitted"]))) < 12


def test_other_results_have_nothing_to_compare(closed):
    assert load_fit_shapes(closed.result, load_poses(closed.result)) is None
