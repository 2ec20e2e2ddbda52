import numpy as np
import pytest
from scipy import sparse
from scipy.sparse import csgraph

from cageik_cli.geometry.groups import find_groups


@pytest.mark.parametrize("pair_count", [0, 1, 30, 100, 150, 400])
def test_groups_are_connected_components(pair_count):
    generator = np.random.default_rng(pair_count)
    pairs = generator.integers(0, 200, (pair_count, 2))
    graph = sparse.coo_array((np.ones(pair_count), tuple(pairs.T)), shape=(200, 200))
    expected = csgraph.connected_components(graph, directed=False)[1]
    np.testing.assert_array_equal(find_groups(pairs, 200), expected)


@pytest.mark.parametrize("order", ["up", "down", "mixed"])
def test_a_long_chain_is_one_group(order):
    numbers = np.arange(20_000)
    if order == "down":
        numbers = numbers[::-1]
    elif order == "mixed":
        numbers = np.random.default_rng(0).permutation(numbers)
    pairs = np.stack([numbers[:-1], numbers[1:]], axis=1)
    assert not find_groups(pairs, len(numbers)).any()
