"""Which samples touch a cage while it is pushed, and at which sheets of it."""

import numpy as np
import pytest

from cageik_cli.cages.builder.refine import ContactSearch, find_contacts
from tests.shapes import ball, box, changed

MIDDLE = np.array([[0.1, 0.05, 0.0]])
"""A sample in the middle of a flat box, off the edges of its faces."""


def slab(low, high):
    """A box between two heights."""
    corners = box().vertices.copy()
    corners[:, 2] = np.where(corners[:, 2] > 0, high, low)
    return changed(box(), vertices=corners)


def test_samples_that_are_deep_are_not_measured_and_no_contact_is_missed():
    generator = np.random.default_rng(0)
    samples = generator.uniform(-0.5, 0.5, (400, 3))
    search, cage, longest = ContactSearch(samples, 0.05), ball(2), 0.0
    for _ in range(4):
        found, (expected, depths) = (
            search.find(cage, longest),
            find_contacts(cage, samples, 0.05),
        )
        np.testing.assert_array_equal(found.corners, expected.corners)
        np.testing.assert_array_equal(found.missing, expected.missing)
        assert (depths >= 0.05).any()
        moves = generator.normal(0, 0.005, cage.vertices.shape)
        cage, longest = (
            cage.move(cage.vertices + moves),
            np.linalg.norm(moves, axis=1).max(),
        )


def test_nothing_touches_a_cage_that_all_samples_are_deep_in():
    search = ContactSearch(np.zeros((1, 3)), 0.05)
    assert len(search.find(ball(2), 0.0).missing) == 0
    assert search.find(ball(2), 0.1) is None


def test_the_sheet_that_was_nearest_before_stays_a_contact():
    """The lower sheet is nearest at first, then the upper one; both are nearer than 0.1."""
    search = ContactSearch(MIDDLE, 0.1)
    first = search.find(slab(-0.03, 0.06), 0.0)
    np.testing.assert_allclose(first.direction, [[0, 0, -1]], atol=1e-12)
    second = search.find(slab(-0.05, 0.02), 0.04)
    np.testing.assert_allclose(second.direction, [[0, 0, 1], [0, 0, -1]], atol=1e-12)
    np.testing.assert_allclose(second.missing, [0.08, 0.05], rtol=1e-9)
    lower = slab(-0.05, 0.02).vertices[second.corners[1]]
    np.testing.assert_allclose(second.weights[1] @ lower, [0.1, 0.05, -0.05], atol=1e-12)


@pytest.mark.parametrize("cage", [slab(-0.2, 0.02), slab(-0.05, -0.01)])
def test_a_sheet_that_is_far_or_on_the_same_side_is_no_second_contact(cage):
    """The lower sheet went away; or the sample is above both, and the upper one is to rise."""
    search = ContactSearch(MIDDLE, 0.1)
    search.find(slab(-0.03, 0.06), 0.0)
    found = search.find(cage, 0.2)
    assert len(found.missing) == (1 if cage.vertices[:, 2].max() > 0 else 2)
