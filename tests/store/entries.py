"""An entry of the cache of weights."""

import numpy as np

from tests.shapes import box


def entry(seed=0, rows=5):
    """One of a box, with as many rows of weights."""
    return {
        "faces": box().faces,
        "weights": np.random.default_rng(seed).dirichlet(np.ones(8), rows),
        "panels": 60,
        "estimated_error": 1e-3,
        "projected": 2,
        "notes": ("ä note", "another"),
        "cage_warnings": ("ü",),
        "has_loose_cage": True,
        "seconds": 1.5,
    }


def same(found, expected):
    """Whether two entries are equal."""
    return found.keys() == expected.keys() and all(
        np.array_equal(found[name], expected[name]) for name in expected
    )
