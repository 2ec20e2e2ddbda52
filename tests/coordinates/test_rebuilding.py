"""Meshes from cages, in products of some frames each."""

import numpy as np
import pytest

from cageik_cli.coordinates.binding import GROUP, rebuilt


@pytest.mark.parametrize("count", [0, 1, GROUP, 2 * GROUP + 3])
def test_a_product_of_some_frames_is_that_of_each(count):
    random = np.random.default_rng(1)
    weights, cages = random.random((7, 4)), random.random((count, 4, 3))
    expected = np.array([weights @ cage for cage in cages]).reshape(count, 7, 3)
    np.testing.assert_allclose(rebuilt(weights, cages), expected, rtol=1e-14, atol=0)


def test_parts_of_whole_groups_give_the_same_bits():
    random = np.random.default_rng(2)
    weights, cages = random.random((7, 4)), random.random((3 * GROUP, 4, 3))
    parts = [rebuilt(weights, cages[:GROUP]), rebuilt(weights, cages[GROUP:])]
    np.testing.assert_array_equal(np.concatenate(parts), rebuilt(weights, cages))
