import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cageik_cli.geometry import rotations
from cageik_cli.geometry.rotations import (
    are_rotations,
    nearest_rotations_by_entry,
    nearest_rotations_by_svd,
)
from tests.shapes import rotation

COUNT = 300


def nearest_rotations(matrices):
    return nearest_rotations_by_entry(matrices.reshape(-1, 9).T).T.reshape(-1, 3, 3)


def turned(sizes):
    """Matrices U diag(sizes) V of random rotations U and V, and the nearest rotations U V."""
    left = np.stack([rotation(2 * k) for k in range(len(sizes))])
    right = np.stack([rotation(2 * k + 1) for k in range(len(sizes))])
    return (left * np.asarray(sizes)[:, None, :]) @ right, left @ right


def spread(low, high):
    return 10 ** np.random.default_rng(5).uniform(low, high, COUNT)


ONES, ZEROS = np.ones(COUNT), np.zeros(COUNT)
SIZES = {
    "any": np.sort(np.random.default_rng(1).uniform(0.2, 3, (COUNT, 3)))[:, ::-1],
    "equal": np.ones((COUNT, 3)),
    "nearly equal": np.column_stack([ONES, 1 - spread(-12, -3), 1 - spread(-9, -1)]),
    "planar": np.column_stack([ONES, np.linspace(0.05, 1, COUNT), ZEROS]),
    "nearly planar": np.column_stack([ONES, 0.5 * ONES, spread(-16, -4)]),
    "reflections": np.column_stack([2 * ONES, ONES, -np.linspace(1e-6, 0.9, COUNT)]),
    "long and thin": np.column_stack([ONES, spread(-2, -0.1), ZEROS]),
}
"""Singular values, the last with the sign of the determinant: the nearest rotation is unique."""


@pytest.mark.parametrize("sizes", SIZES.values(), ids=SIZES)
@pytest.mark.parametrize("scale", [1.0, 1e-170, 1e-148, 1e-60, 1e60, 1e150, 1e290])
def test_rotations_are_those_that_the_matrices_were_made_from(sizes, scale):
    matrices, expected = turned(sizes)
    np.testing.assert_allclose(nearest_rotations(scale * matrices), expected, atol=3e-13)
    np.testing.assert_allclose(nearest_rotations_by_svd(scale * matrices), expected, atol=3e-13)


@settings(max_examples=200)
@given(st.integers(0, 10**6), st.floats(0, 1), st.floats(-1, 1))
def test_no_rotation_has_a_larger_trace(seed, middle, last):
    """Also where roots meet, and which rotation is nearest rounding may decide: it is one."""
    last *= middle
    matrix = rotation(seed) * [1.0, middle, last] @ rotation(seed + 1)
    (found,) = nearest_rotations(matrix[None])
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(found) == pytest.approx(1, abs=1e-12)
    assert np.sum(found * matrix) == pytest.approx(1 + middle + last, abs=1e-13)


def test_reflections_that_have_many_nearest_rotations_get_one_of_them():
    matrices = np.stack([np.diag(signs) for signs in ([1, 1, -1], [-1, 1, 1], [-1, -1, -1])])
    found = nearest_rotations(matrices.astype(float))
    np.testing.assert_allclose(np.linalg.det(found), 1, atol=1e-14)
    np.testing.assert_allclose((found * matrices).sum(axis=(1, 2)), 1, atol=1e-14)


def test_zeros_get_the_identity_and_lines_a_rotation_that_keeps_them():
    line = np.outer([0, 0.6, 0.8], [1.0, 0, 0])
    zero, kept = nearest_rotations(np.stack([np.zeros((3, 3)), line]))
    np.testing.assert_array_equal(zero, np.eye(3))
    np.testing.assert_allclose(kept @ [1, 0, 0], [0, 0.6, 0.8], atol=1e-14)
    assert np.linalg.det(kept) == pytest.approx(1)


def test_no_matrix_gives_no_rotation():
    assert nearest_rotations(np.empty((0, 3, 3))).shape == (0, 3, 3)


def test_what_is_given_is_left_as_it_was():
    entries = np.random.default_rng(0).normal(size=(9, 20))
    kept = entries.copy()
    nearest_rotations_by_entry(entries)
    np.testing.assert_array_equal(entries, kept)


def test_few_matrices_are_decomposed(monkeypatch):
    """Those of ordinary cells are not: that is where the speed comes from."""
    monkeypatch.setattr(rotations, "nearest_rotations_by_svd", pytest.fail)
    for name in ("any", "equal", "nearly equal", "nearly planar"):
        matrices, expected = turned(SIZES[name])
        np.testing.assert_allclose(nearest_rotations(matrices), expected, atol=3e-13)


@pytest.mark.parametrize(
    ("limit", "value", "sizes"),
    [
        ("MIN_ROOT_SLOPE", -1.0, [1.0, 1e-9, 0.0]),
        ("MIN_MATRIX_NORM", 0.0, [1e-161, 5e-162, 2e-162]),
        ("MAX_LAST_NEWTON_STEP", np.inf, [1.0, 0.97, -0.68]),
    ],
)
def test_every_limit_is_needed(monkeypatch, limit, value, sizes):
    """Without it, digits are lost that singular values keep."""
    matrices, _ = turned([sizes] * 20)

    def short():
        traces = (nearest_rotations(matrices) * matrices).sum(axis=(1, 2))
        found = nearest_rotations(matrices)
        wrong = np.abs(found @ found.swapaxes(1, 2) - np.eye(3)).max()
        return max(wrong, np.abs(traces / sum(sizes) - 1).max())

    assert short() < 1e-12
    monkeypatch.setattr(rotations, limit, value)
    assert not short() < 1e-9


def test_rotations_are_told_from_other_matrices():
    turn = rotation(1)
    sheared, unknown = turn.copy(), turn.copy()
    sheared[0, 1] += 1e-8
    unknown[2, 2] = np.nan
    others = [-turn, 2 * turn, sheared, unknown, np.zeros((3, 3)), np.full((3, 3), 1e300)]
    assert are_rotations(np.stack([turn, *others])).tolist() == [True] + 6 * [False]
