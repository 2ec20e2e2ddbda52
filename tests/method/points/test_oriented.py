import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import sph_harm_y

from cageik_cli.method.points.oriented import (
    MIN_AXIS,
    REST_COUNTS,
    Oriented,
    determinants,
    evaluate_band,
    move_ellipsoids,
    move_normals,
    quaternions_to_rotations,
    rotate_harmonics,
    rotations_to_quaternions,
)

RANDOM = np.random.default_rng(5)
NORMALS = RANDOM.standard_normal((3, 40))
NORMALS /= np.linalg.norm(NORMALS, axis=0)


def repeat(matrix):
    return np.repeat(np.asarray(matrix, float)[:, :, None], NORMALS.shape[1], axis=2)


def test_rotations_turn_normals():
    turns = Rotation.random(40, random_state=1).as_matrix()
    moved = move_normals(NORMALS, np.ascontiguousarray(turns.transpose(1, 2, 0)))
    expected = np.einsum("mik,km->im", turns, NORMALS)
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("size", [1e-120, 1.0, 1e120])
def test_linear_maps_turn_normals_by_the_inverse_transpose(size):
    """Also maps that turn space inside out, of any size."""
    maps = RANDOM.standard_normal((40, 3, 3))
    assert (np.linalg.det(maps) < 0).any()
    expected = np.linalg.solve(maps.swapaxes(1, 2), NORMALS.T[:, :, None])[:, :, 0]
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    moved = move_normals(NORMALS * 7, np.ascontiguousarray(maps.transpose(1, 2, 0)) * size)
    np.testing.assert_allclose(moved, expected.T, rtol=0, atol=1e-12)


def test_a_sheet_has_the_normal_of_its_plane():
    moved = move_normals(NORMALS, repeat(np.diag([1, 2, 0])))
    expected = np.zeros_like(NORMALS)
    expected[2] = np.sign(NORMALS[2])
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("matrix", [np.zeros((3, 3)), np.diag([1, 0, 0]), np.full((3, 3), np.nan)])
def test_without_a_direction_normals_stay(matrix):
    np.testing.assert_array_equal(move_normals(NORMALS, repeat(matrix)), NORMALS)


def test_what_is_no_normal_stays():
    normals = NORMALS.copy()
    normals[:, 3], normals[1, 5], normals[0, 7] = 0, np.nan, np.inf
    moved = move_normals(normals, repeat(np.diag([1, 2, 3])))
    kept = [3, 5, 7]
    np.testing.assert_array_equal(moved[:, kept], normals[:, kept])
    others = np.delete(moved, kept, axis=1)
    np.testing.assert_allclose(np.linalg.norm(others, axis=0), 1, rtol=1e-14)


def test_some_points_may_be_chosen():
    part = Oriented(NORMALS)[2:9]
    assert part.splats is None
    moved = part.move(repeat(np.diag([1, 2, 3]))[:, :, 2:9])
    assert moved.normals is not None
    whole = move_normals(NORMALS, repeat(np.diag([1, 2, 3])))
    np.testing.assert_array_equal(moved.normals, whole[:, 2:9])
    assert Oriented().move(repeat(np.eye(3))).normals is None


COUNT = 300


def random_ellipsoids(seed=0, low=-12.0, high=-2.0):
    random = np.random.default_rng(seed)
    turns = random.normal(size=(4, COUNT))
    axes = np.exp(random.uniform(low, high, (3, COUNT)))
    return axes, turns / np.linalg.norm(turns, axis=0)


def covariance(axes, quaternions):
    """(m, 3, 3), with SciPy's rotations."""
    turns = Rotation.from_quat(np.roll(quaternions.T, -1, axis=1)).as_matrix()
    frames = turns * axes.T[:, None]
    return frames @ frames.swapaxes(1, 2)


def moved_covariance(rest, maps):
    found = maps.transpose(2, 0, 1)
    return found @ covariance(*rest) @ found.swapaxes(1, 2)


def assert_same_covariance(found, expected, rtol=1e-13):
    size = np.abs(expected).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(found / size, expected / size, rtol=0, atol=rtol)


@pytest.mark.parametrize("amount", [0.0, 0.01, 0.5, 3.0])
def test_covariances_are_moved(amount):
    rest = random_ellipsoids()
    maps = np.eye(3)[:, :, None] + amount * np.random.default_rng(1).normal(size=(3, 3, COUNT))
    moved = move_ellipsoids(*rest, maps)
    assert_same_covariance(covariance(*moved), moved_covariance(rest, maps))
    np.testing.assert_allclose(np.linalg.norm(moved[1], axis=0), 1, rtol=1e-14)
    assert (np.sum(moved[1] * rest[1], axis=0) >= 0).all()


def test_small_axes_keep_their_digits():
    """Eigenvalues of the covariance would lose them: the axes differ by up to a million times."""
    axes, quaternions = rest = random_ellipsoids(low=-16.0, high=-2.0)
    maps = np.eye(3)[:, :, None] + 0.2 * np.random.default_rng(1).normal(size=(3, 3, COUNT))
    turned = quaternions_to_rotations(quaternions) * axes
    columns = np.einsum("ijm,jkm->mik", maps, turned)
    # The smallest of three from the product of all, which is exact.
    volume = np.abs(determinants(maps)) * axes.prod(axis=0)
    moved = np.sort(move_ellipsoids(*rest, maps)[0], axis=0)
    np.testing.assert_allclose(moved.prod(axis=0), volume, rtol=1e-12)
    np.testing.assert_allclose(moved[2], np.linalg.norm(columns, 2, axis=(1, 2)), rtol=1e-12)


@pytest.mark.parametrize("size", [1e-50, 1e50])
@pytest.mark.parametrize("low", [-70.0, 70.0])
def test_sizes_whose_squares_are_no_numbers_are_moved(low, size):
    rest = random_ellipsoids(low=low, high=low + 10)
    maps = np.eye(3)[:, :, None] + 0.5 * np.random.default_rng(1).normal(size=(3, 3, COUNT))
    expected = move_ellipsoids(*rest, maps)
    moved = move_ellipsoids(*rest, size * maps)
    np.testing.assert_allclose(
        moved[0], np.maximum(size * expected[0], MIN_AXIS), rtol=1e-12, atol=0
    )


def test_rigid_motions_keep_the_order_of_the_axes():
    axes, quaternions = rest = random_ellipsoids()
    turn = Rotation.from_rotvec([0.3, -1.2, 0.5])
    maps = np.repeat(turn.as_matrix()[:, :, None], COUNT, axis=2)
    moved = move_ellipsoids(*rest, maps)
    np.testing.assert_allclose(moved[0], axes, rtol=1e-13)
    before = Rotation.from_quat(np.roll(quaternions.T, -1, axis=1))
    after = Rotation.from_quat(np.roll(moved[1].T, -1, axis=1))
    np.testing.assert_allclose(after.as_matrix(), (turn * before).as_matrix(), rtol=0, atol=1e-13)


def test_the_identity_changes_nothing():
    axes, quaternions = rest = random_ellipsoids()
    moved = move_ellipsoids(*rest, np.repeat(np.eye(3)[:, :, None], COUNT, axis=2))
    np.testing.assert_allclose(moved[0], axes, rtol=1e-14)
    np.testing.assert_allclose(moved[1], quaternions, rtol=0, atol=1e-15)


def test_reflections_give_rotations_with_the_same_covariance():
    rest = random_ellipsoids()
    maps = np.repeat(np.diag([1.0, 1.0, -1.0])[:, :, None], COUNT, axis=2)
    maps = maps + 0.1 * np.random.default_rng(2).normal(size=maps.shape)
    assert (determinants(maps) < 0).all()
    moved = move_ellipsoids(*rest, maps)
    assert_same_covariance(covariance(*moved), moved_covariance(rest, maps))


@pytest.mark.parametrize("rank", [0, 1, 2])
def test_flat_maps_give_whole_frames(rank):
    rest = random_ellipsoids(low=-3.0)
    flat = np.diag([1.0] * rank + [0.0] * (3 - rank))
    maps = np.repeat(flat[:, :, None], COUNT, axis=2)
    moved = move_ellipsoids(*rest, maps)
    turns = quaternions_to_rotations(moved[1])
    np.testing.assert_allclose(determinants(turns), 1, rtol=1e-12)
    assert (moved[0] >= MIN_AXIS).all()
    expected = moved_covariance(rest, maps)
    np.testing.assert_allclose(covariance(*moved), expected, rtol=0, atol=1e-15)


def test_quaternions_of_half_turns_are_found():
    """Where the largest component changes, and w is zero."""
    turns = np.concatenate([np.pi * np.eye(3), (np.pi - 1e-9) * np.eye(3), np.zeros((1, 3))])
    matrices = Rotation.from_rotvec(turns).as_matrix().transpose(1, 2, 0)
    found = quaternions_to_rotations(rotations_to_quaternions(matrices))
    np.testing.assert_allclose(found, matrices, rtol=0, atol=1e-14)


DEGREES = (1, 2, 3)


def random_directions(count, seed=0):
    directions = np.random.default_rng(seed).normal(size=(3, count))
    return directions / np.linalg.norm(directions, axis=0)


def random_turns(count, seed=1):
    return Rotation.random(count, rng=np.random.default_rng(seed)).as_matrix().transpose(1, 2, 0)


def evaluate(coefficients, directions):
    """The functions, (3, m), of coefficients (3, c, m) at a direction each, (3, m)."""
    values = np.zeros((3, directions.shape[1]))
    harmonics = [h for degree in DEGREES for h in evaluate_band(degree, directions)]
    for i in range(coefficients.shape[1]):
        values += coefficients[:, i] * harmonics[i]
    return values


@pytest.mark.parametrize("degree", DEGREES)
def test_harmonics_are_those_of_scipy_without_its_sign(degree):
    """The real harmonics, with the sign (-1)^m that Gaussian splats have twice: for m and -m."""
    directions = random_directions(50)
    x, y, z = directions
    polar, azimuth = np.arccos(z), np.arctan2(y, x)
    for m, found in zip(range(-degree, degree + 1), evaluate_band(degree, directions), strict=True):
        complex_value = sph_harm_y(degree, abs(m), polar, azimuth)
        part = complex_value.real if m >= 0 else complex_value.imag
        expected = part * (np.sqrt(2) if m else 1)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)


@pytest.mark.parametrize("count", REST_COUNTS)
def test_a_turned_function_has_the_values_of_the_function_turned_back(count):
    m = 200
    coefficients = np.random.default_rng(2).normal(size=(3, count, m)).astype(np.float32)
    turns, directions = random_turns(m), random_directions(m, 3)
    turned = rotate_harmonics(coefficients, turns.astype(np.float32))
    back = np.einsum("ijm,im->jm", turns, directions)
    expected = evaluate(coefficients, back)
    np.testing.assert_allclose(evaluate(turned, directions), expected, rtol=0, atol=1e-5)
    norms = [np.linalg.norm(array, axis=1) for array in (turned, coefficients)]
    np.testing.assert_allclose(*norms, rtol=1e-5)


def test_two_turns_are_one():
    m = 100
    coefficients = np.random.default_rng(2).normal(size=(3, 15, m)).astype(np.float32)
    first, second = random_turns(m, 4), random_turns(m, 5)
    both = np.einsum("ijm,jkm->ikm", second, first)
    one = rotate_harmonics(coefficients, both.astype(np.float32))
    two = rotate_harmonics(coefficients, first.astype(np.float32))
    two = rotate_harmonics(two, second.astype(np.float32))
    np.testing.assert_allclose(one, two, rtol=0, atol=2e-5)
