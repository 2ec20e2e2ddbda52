import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cageik_cli.method.points.oriented import Oriented, move_normals

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
