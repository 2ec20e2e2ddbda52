"""An entry of the cache of weights."""

import numpy as np

from cageik_cli.store.weight_cache import CacheEntry
from tests.shapes import box


def entry(seed=0, rows=5):
    """One of a box, with as many rows of weights."""
    weights = np.random.default_rng(seed).dirichlet(np.ones(8), rows)
    notes = ("ä note", "another")
    return CacheEntry(box().faces, weights, 60, 1e-3, 2, notes, ("ü",), True, 1.5)


def same(found, expected):
    """Whether two entries are equal; asserted of their arrays."""
    np.testing.assert_array_equal(found.faces, expected.faces)
    np.testing.assert_array_equal(found.weights, expected.weights)
    names = ("panels", "estimated_error", "projected", "notes", "has_loose_cage", "seconds")
    return all(getattr(found, name) == getattr(expected, name) for name in names)
