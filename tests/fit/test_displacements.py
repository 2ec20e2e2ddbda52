import numpy as np
import pytest

from cageik_cli.fit.problem import COMPRESSION_TOL, Displacements

RANDOM = np.random.default_rng(3)
SMOOTH = RANDOM.normal(size=(200, 9)) @ RANDOM.normal(size=(9, 120))
"""Displacements of 40 frames that have nine directions."""


def whole(target):
    return np.hstack(list(target.blocks()))


@pytest.mark.parametrize("row_weights", [None, RANDOM.uniform(size=200)])
def test_the_product_with_the_transpose_is_summed_over_blocks_of_rows(row_weights):
    target = Displacements.of(SMOOTH).take(np.arange(3, 30))
    data = whole(target)
    expected = data.T @ (data if row_weights is None else row_weights[:, None] * data)
    found = target.multiply_by_transpose(row_weights, max_entries=1000)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_compressed_displacements_have_the_same_products_of_rows():
    target = Displacements.of(SMOOTH)
    compressed = target.compress()
    assert len(compressed) == 3
    assert compressed.weight == target.weight
    data, short = whole(target), whole(compressed)
    np.testing.assert_allclose(short @ short.T, data @ data.T, rtol=0, atol=1e-10)


def test_a_compression_leaves_out_what_is_below_its_tolerance():
    noise = RANDOM.normal(size=SMOOTH.shape)
    noise *= COMPRESSION_TOL * np.linalg.norm(SMOOTH) / np.linalg.norm(noise)
    assert len(Displacements.of(SMOOTH + 0.5 * noise).compress()) == 3
    assert len(Displacements.of(SMOOTH + 5 * noise).compress()) > 3


def test_vertices_without_weight_do_not_count_in_a_compression():
    wild = SMOOTH.copy()
    wild[:20] = 1e6 * RANDOM.normal(size=(20, SMOOTH.shape[1]))
    weights = np.ones(len(wild))
    weights[:20] = 0
    data, short = SMOOTH[20:], whole(Displacements.of(wild).compress(weights))[20:]
    np.testing.assert_allclose(short @ short.T, data @ data.T, rtol=0, atol=1e-9)


@pytest.mark.parametrize("columns", [RANDOM.normal(size=(200, 30)), np.zeros((200, 30))])
def test_displacements_that_cannot_be_compressed_are_returned(columns):
    target = Displacements.of(columns)
    assert target.compress() is target


def test_single_precision_is_kept():
    assert Displacements.of(SMOOTH.astype(np.float32)).compress().parts[0].dtype == np.float32
