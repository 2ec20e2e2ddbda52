"""Weights as integers: close, with the sums of the rows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cageik_cli.report.player import quantization
from cageik_cli.report.player.quantization import MAX_LEVEL, find_smooth_motions
from tests.shapes import ball


def round_weights(weights):
    """Round weights without motions in which they are kept more precisely."""
    return quantization.round_weights(weights, np.empty((weights.shape[1], 0)))


def _random_weights(seed, rows, columns, signed):
    weights = np.random.default_rng(seed).normal(size=(rows, columns))
    weights = weights if signed else np.abs(weights)
    return weights / weights.sum(axis=1, keepdims=True)


@given(st.integers(0, 1000), st.integers(1, 40), st.integers(1, 30), st.booleans())
def test_rows_keep_their_sum_and_entries_are_near(seed, rows, columns, signed):
    weights = _random_weights(seed, rows, columns, signed)
    rounded = round_weights(weights)
    sums = rounded.integers.astype(int).sum(axis=1)
    assert (sums == np.rint(rounded.levels)).all()
    assert np.abs(rounded.integers - rounded.levels * weights).max() <= 1


def test_a_cage_that_moves_as_one_moves_the_mesh_exactly():
    rounded = round_weights(_random_weights(3, 200, 50, True))
    moved = rounded.integers.astype(float) @ np.full(50, 1e6) / rounded.levels
    np.testing.assert_allclose(moved, 1e6, rtol=1e-12)


def test_more_rows_than_a_block_are_rounded_alike(monkeypatch):
    weights = _random_weights(5, 30, 9, True)
    whole = round_weights(weights)
    monkeypatch.setattr("cageik_cli.report.player.quantization.ROWS_PER_BLOCK", 7)
    np.testing.assert_array_equal(round_weights(weights).integers, whole.integers)


@pytest.mark.parametrize("size", [0.0, 1e-300, 1.0, 1e5, 1e300])
def test_weights_of_any_size_are_rounded(size):
    rounded = round_weights(np.array([[size, -size, 0.0]]))
    assert np.abs(rounded.integers).max() <= MAX_LEVEL
    assert np.isfinite(rounded.levels)
    np.testing.assert_allclose(rounded.integers / rounded.levels, [[size, -size, 0]], rtol=1e-4)


def test_smooth_motions_are_kept_more_precisely():
    cage = ball(levels=2, size=1.0)
    motions = find_smooth_motions(cage)
    np.testing.assert_allclose(motions.T @ motions, np.eye(motions.shape[1]), atol=1e-12)
    weights = _random_weights(1, 300, len(cage.vertices), False)
    rounded = quantization.round_weights(weights, motions)
    lost = rounded.restore() - weights
    plain = round_weights(weights).integers / rounded.levels - weights
    assert np.abs(lost @ motions).max() < 0.01 * np.abs(plain @ motions).max()
    # Smooth motions hold the affine ones of a ball nearly.
    assert np.abs(lost @ cage.vertices).max() < 0.1 * np.abs(plain @ cage.vertices).max()


def test_a_tetrahedron_has_fewer_smooth_motions(animation):
    assert find_smooth_motions(animation.cage).shape == (8, 7)
