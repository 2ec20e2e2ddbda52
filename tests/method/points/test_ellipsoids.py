import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cageik_cli.method.points.oriented import (
    MIN_AXIS,
    determinants,
    move_ellipsoids,
    quaternions_to_rotations,
    rotations_to_quaternions,
)

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
