"""A fit transferred to other points in a cage: exact rows and derivatives, and where it ends."""

from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.cages.bind import bind
from cageik_cli.fit.transferred import MAX_TRANSFER_DISTANCE, TransferredChange, compute_fade
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.points import PointCloud
from cageik_cli.method.points.field import HarmonicField
from cageik_cli.method.points.motion import PointMotion
from cageik_cli.method.points.oriented import Oriented
from cageik_cli.method.weights.binding import Binding, Poses
from cageik_cli.method.weights.settings import BindSettings
from tests.fitted import true_weights
from tests.shapes import ball, finer, rotation

CAGE = ball(1, 1.0)
LENGTH = MAX_TRANSFER_DISTANCE * 2 * 0.6 * np.sqrt(3)
"""How far a fit reaches from the model, which is a ball of radius 0.6."""


def interpolate(points):
    """Affine-exact weights of any points, (m, n): the simplest, which are linear in x."""
    ones = np.ones((len(CAGE.vertices), 1))
    affine = np.hstack([ones, CAGE.vertices])
    return np.hstack([np.ones((len(points), 1)), points]) @ np.linalg.pinv(affine)


def bind_points(points):
    return Binding(PointCloud.from_points(points), CAGE, interpolate(points))


@pytest.fixture(scope="module")
def computed():
    rest = ball(2, 0.6)
    return Binding(rest, CAGE, interpolate(rest.vertices))


@pytest.fixture(scope="module")
def fitted(computed):
    return replace(computed, weights=true_weights(computed))


@pytest.fixture(scope="module")
def change(fitted, computed):
    return TransferredChange(fitted, computed.weights)


def carry(change, points):
    return change.add_to(bind_points(points), change.locate(points)).weights


def directions(count, seed=3):
    held = np.random.default_rng(seed).normal(size=(count, 3))
    return held / np.linalg.norm(held, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def points():
    """Inside the model, above it, and farther away than a fit reaches."""
    radii = np.random.default_rng(4).uniform(0.45, 0.9, (400, 1))
    return radii * directions(400)


def assert_affine_exact(weights, points):
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=0, atol=1e-12)
    np.testing.assert_allclose(weights @ CAGE.vertices, points, rtol=0, atol=1e-12)


def test_rows_stay_exact(change, points):
    assert_affine_exact(carry(change, points), points)


def test_weights_in_single_precision_leave_rows_exact(fitted, points, computed):
    rounded = replace(fitted, weights=fitted.weights.astype(np.float32).astype(np.float64))
    weights = carry(TransferredChange(rounded, computed.weights), points)
    assert_affine_exact(weights, points)
    plain = rounded.weights - computed.weights
    assert abs(plain @ CAGE.vertices).max() > 1e-9


def test_vertices_of_the_model_have_its_rows_to_the_bit(change, fitted):
    shuffled = np.random.default_rng(0).permutation(len(fitted.weights))
    weights = carry(change, fitted.rest.vertices[shuffled])
    np.testing.assert_array_equal(weights, fitted.weights[shuffled])
    moved = carry(change, fitted.rest.vertices + 1e-6)
    assert 0 < abs(moved - fitted.weights).max() < 1e-4


def test_a_finer_surface_interpolates_the_change(change, fitted, computed):
    mesh = finer(fitted.rest, 1)
    found = carry(change, mesh.vertices) - interpolate(mesh.vertices)
    means = (fitted.weights - computed.weights)[fitted.rest.faces].mean(axis=1)
    centroids = fitted.rest.vertices[fitted.rest.faces].mean(axis=1)
    at_centroids = carry(change, centroids) - interpolate(centroids)
    np.testing.assert_allclose(at_centroids, means, rtol=0, atol=1e-12)
    assert abs(found).max() > 0.01


def test_far_away_weights_are_computed_ones(change):
    """And just within reach they are not: the check of the fade fails with a longer one."""
    for radius, is_far in ((0.6 + 1.02 * LENGTH, True), (0.6 + 0.8 * LENGTH, False)):
        points = radius * directions(50)
        is_same = (carry(change, points) == interpolate(points)).all(axis=1)
        assert is_same.all() if is_far else not is_same.any()


def test_the_fade_has_no_slope_at_its_ends():
    fade, slope = compute_fade(np.array([0, 0.5, 1, 7]))
    np.testing.assert_array_equal(fade, [1, 0.5, 0, 0])
    np.testing.assert_array_equal(slope, [0, -1.5, 0, 0])
    t, step = np.linspace(0.01, 0.99, 30), 1e-6
    differences = (compute_fade(t + step)[0] - compute_fade(t - step)[0]) / (2 * step)
    np.testing.assert_allclose(compute_fade(t)[1], differences, rtol=0, atol=1e-9)


def find_gradients(change, points):
    found = np.zeros((len(points), len(CAGE.vertices), 3))
    change.add_gradients_to(found, points)
    return found


def difference_gradients(change, points, step=1e-6):
    values = [
        [carry(change, places) - interpolate(places) for places in (points + s, points - s)]
        for s in step * np.eye(3)
    ]
    return np.stack([(after - before) / (2 * step) for after, before in values], axis=2)


def test_gradients_are_derivatives(change, fitted, points):
    """Above faces, sides and corners, and within reach or not."""
    nearest = change.locate(points)
    kinds = (nearest.shares > 1e-9).sum(axis=1)
    assert set(kinds) == {1, 2, 3}
    found, expected = find_gradients(change, points), difference_gradients(change, points)
    close = np.abs(found - expected).max(axis=(1, 2)) < 1e-5
    # A difference across the bounds of what is closest to a face is not a derivative.
    assert close.mean() > 0.99
    assert abs(expected).max() > 0.1
    np.testing.assert_allclose(found.sum(axis=1), 0, rtol=0, atol=1e-11)
    moments = found.swapaxes(1, 2) @ CAGE.vertices
    np.testing.assert_allclose(moments, 0, rtol=0, atol=1e-11)


def test_gradients_on_the_surface_are_those_of_the_face(change, fitted, computed):
    faces = fitted.rest.vertices[fitted.rest.faces]
    points = faces.mean(axis=1)
    found = find_gradients(change, points)
    changes = (fitted.weights - computed.weights)[fitted.rest.faces]
    for k in (1, 2):
        along = faces[:, k] - faces[:, 0]
        slope = np.einsum("mnx,mx->mn", found, along)
        np.testing.assert_allclose(slope, changes[:, k] - changes[:, 0], rtol=0, atol=1e-11)
    normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    np.testing.assert_allclose(np.einsum("mnx,mx->mn", found, normals), 0, rtol=0, atol=1e-11)


def test_left_out_vertices_are_predicted_from_around_them(fitted):
    """From the closest side that is left, and nothing of their own."""
    side = 21
    grid = np.stack(np.meshgrid(*2 * [np.arange(side)], [0.0]), -1).reshape(-1, 3)
    corners = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).reshape(-1, 1, 1)
    faces = (corners + np.array([[0, 1, side + 1], [0, side + 1, side]])).reshape(-1, 3)
    weights = np.zeros((side**2, len(CAGE.vertices)))
    change = TransferredChange(replace(fitted, rest=TriMesh(grid, faces), weights=weights), weights)
    middle = side * (side // 2) + side // 2
    found = change.predict_left_out(np.column_stack([np.ones(side**2), np.eye(side**2)[middle]]))
    # The sides around a vertex lead through four at a distance of 1, and halfway between these.
    length = MAX_TRANSFER_DISTANCE * np.sqrt(2) * (side - 1)
    fade, _ = compute_fade(np.array([np.sqrt(0.5)]) / length)
    assert 0.5 < fade[0] < 1
    np.testing.assert_allclose(found[middle], [fade[0], 0], rtol=0, atol=1e-12)
    assert found[:, 1].max() > 0


@pytest.fixture(scope="module")
def few(fitted):
    """Fitted weights that do not reproduce the rest pose: the offsets turn with the frames."""
    noise = np.random.default_rng(8).normal(size=fitted.weights.shape)
    weights = fitted.weights + 0.01 * (noise - noise.mean(axis=1, keepdims=True))
    return replace(fitted, weights=weights, has_offsets=True)


def test_few_influences_carry_with_their_offsets(few, computed):
    change = TransferredChange(few, computed.weights)
    own = bind_points(few.rest.vertices)
    transferred = change.add_to(own, change.locate(few.rest.vertices))
    assert transferred.has_offsets
    np.testing.assert_array_equal(transferred.weights, few.weights)


def test_points_turn_with_offsets(few, computed, points, monkeypatch):
    """A rigid motion of the cage moves points with normals rigidly, if offsets turn with it."""
    change = TransferredChange(few, computed.weights)
    cloud = bind_points(points)
    monkeypatch.setattr(HarmonicField, "solve", staticmethod(lambda *_, **__: _LinearField()))
    transferred = change.add_to(cloud, change.locate(points))
    normals = directions(len(points), 5).T
    motion = PointMotion(
        transferred, Oriented(normals), 1 << 30, 1, add_gradients=change.add_gradients_to
    )
    turn = rotation(2)
    cages = (CAGE.vertices @ turn)[None]
    places, oriented, _ = motion.move(slice(0, len(points)), Poses(cages, turn[None]))
    np.testing.assert_allclose(places[0].T, points @ turn, rtol=0, atol=1e-12)
    np.testing.assert_allclose(oriented[0].normals.T, normals.T @ turn, rtol=0, atol=1e-10)
    still, _, _ = motion.move(slice(0, len(points)), Poses(cages))
    assert abs(still[0].T - points @ turn).max() > 1e-3


def test_splats_turn_by_the_derivative_of_what_is_transferred(fitted):
    """With the gradients of harmonic weights, and without those of the change not."""
    computed = bind(fitted.rest, CAGE, BindSettings(accuracy="preview"))
    change = TransferredChange(replace(computed, weights=true_weights(computed)), computed.weights)
    faces = fitted.rest.vertices[fitted.rest.faces[:40]]
    points = 1.01 * faces.mean(axis=1)
    cloud = bind(PointCloud.from_points(points), CAGE, computed.settings)
    cage = CAGE.vertices + 0.2 * np.square(CAGE.vertices[:, ::-1])
    normals = points.T / np.linalg.norm(points, axis=1)
    field = HarmonicField.solve(CAGE, points, "preview")
    maps = field.gradient(points).swapaxes(1, 2) @ cage
    plain = PointMotion(cloud, Oriented(normals), 1 << 30, 1)
    transferred = change.add_to(cloud, change.locate(points))
    motion = PointMotion(
        transferred, Oriented(normals), 1 << 30, 1, add_gradients=change.add_gradients_to
    )
    whole = maps + difference_gradients(change, points).swapaxes(1, 2) @ cage
    for one, expected, others in ((plain, maps, whole), (motion, whole, maps)):
        found = one.move(one.blocks[0], Poses(cage[None]))[1][0].normals.T
        np.testing.assert_allclose(found, turn_normals(expected, normals), rtol=0, atol=1e-6)
        assert abs(found - turn_normals(others, normals)).max() > 1e-3


def turn_normals(maps, normals):
    """By the inverse transposes of maps, (m, 3, 3), which are transposed themselves."""
    turned = np.linalg.solve(maps, normals.T[:, :, None])[:, :, 0]
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)


class _LinearField:
    """The field of `interpolate`."""

    def gradient(self, points, jobs):
        affine = np.hstack([np.ones((len(CAGE.vertices), 1)), CAGE.vertices])
        return np.repeat(np.linalg.pinv(affine)[1:].T[None], len(points), axis=0)
