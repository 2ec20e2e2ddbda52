"""Meshes from cages, in products of some frames each."""

import numpy as np
import pytest

from cageik_cli.coordinates.binding import FRAMES_PER_PRODUCT, reconstruct


@pytest.mark.parametrize("count", [0, 1, FRAMES_PER_PRODUCT, 2 * FRAMES_PER_PRODUCT + 3])
def test_a_product_of_some_frames_is_that_of_each(count):
    random = np.random.default_rng(1)
    weights, cages = random.random((7, 4)), random.random((count, 4, 3))
    expected = np.array([weights @ cage for cage in cages]).reshape(count, 7, 3)
    np.testing.assert_allclose(reconstruct(weights, cages), expected, rtol=1e-14, atol=0)


def test_parts_of_whole_groups_give_the_same_bits():
    random = np.random.default_rng(2)
    weights, cages = random.random((7, 4)), random.random((3 * FRAMES_PER_PRODUCT, 4, 3))
    parts = [
        reconstruct(weights, cages[:FRAMES_PER_PRODUCT]),
        reconstruct(weights, cages[FRAMES_PER_PRODUCT:]),
    ]
    np.testing.assert_array_equal(np.concatenate(parts), reconstruct(weights, cages))
