"""Cage weights as skin weights, from what skin weights are."""

import numpy as np
import pytest

from cageik_cli.formats.base.skeleton import MIN_WEIGHT, compute_skin_weights
from cageik_cli.util.errors import CageError

RANDOM = np.random.default_rng(7)
CONVEX = RANDOM.dirichlet(np.ones(9), 40) * 0.99 + 0.01 / 9
SIGNED = CONVEX + RANDOM.normal(0, 0.1, CONVEX.shape)
SIGNED /= SIGNED.sum(axis=1, keepdims=True)


def test_convex_weights_are_unchanged():
    np.testing.assert_allclose(compute_skin_weights(CONVEX).to_dense(9), CONVEX, rtol=1e-15)


def test_rows_are_convex():
    skin = compute_skin_weights(SIGNED)
    assert (skin.values >= 0).all()
    np.testing.assert_allclose(skin.values.sum(axis=1), 1, rtol=1e-15)
    assert all(len(set(row)) == len(row) for row in skin.joints.tolist())
    assert (np.diff(skin.values, axis=1) <= 0).all()


def test_negative_weights_are_cut_off_and_the_others_keep_their_proportion():
    skin = compute_skin_weights(np.array([[0.4, -0.2, 0.3, 0.1, 0.4], [0, 0, 0, 0, 1]]))
    expected = [[4 / 12, 0, 3 / 12, 1 / 12, 4 / 12], [0, 0, 0, 0, 1]]
    np.testing.assert_allclose(skin.to_dense(5), expected, rtol=1e-15)


def test_no_more_influences_than_the_fullest_row_has():
    skin = compute_skin_weights(np.array([[0.5, 0.5, 0, 0], [1, 0, 0, 0], [0.25, 0.25, 0, 0.5]]))
    assert skin.joints.shape == (3, 3)
    np.testing.assert_array_equal(skin.values[1], [1, 0, 0])


def test_weights_that_single_precision_does_not_tell_are_dropped():
    small = MIN_WEIGHT / 2
    skin = compute_skin_weights(np.array([[1 - small, small], [0.5, 0.5]]))
    np.testing.assert_array_equal(skin.to_dense(2), [[1, 0], [0.5, 0.5]])


def test_a_row_without_a_weight_above_zero_is_refused():
    with pytest.raises(CageError, match="vertex 1 has no weight above zero"):
        compute_skin_weights(np.array([[1.0, 0], [0, 0]]))


def test_blocks_of_rows_give_the_same():
    whole, parts = (compute_skin_weights(SIGNED, block_rows=rows) for rows in (1 << 14, 7))
    np.testing.assert_array_equal(parts.joints, whole.joints)
    np.testing.assert_array_equal(parts.values, whole.values)
