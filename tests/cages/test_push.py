import numpy as np
import pytest

from cageik_cli.cages.push import MAX_FRUITLESS_PUSHES, Contacts, push
from tests.shapes import box


def contact(missing):
    """The middle of a side of the box is too near."""
    corners, weights = np.array([[4, 6, 7]]), np.array([[0.25, 0.25, 0.5]])
    return Contacts(corners, weights, np.array([[1.0, 0, 0]]), np.array([missing]))


def run(find_contacts, **options):
    return push(box(), find_contacts, smoothness=0.02, stiffness=0.02, **options)


def test_pushes_end_when_nothing_is_missing():
    asked = []

    def find_contacts(cage, longest):
        asked.append(longest)
        return None if len(asked) > 1 else contact(0.1)

    move = run(find_contacts).vertices - box().vertices
    assert move[[4, 6, 7], 0].min() > 0.05
    assert asked == [0.0, pytest.approx(np.linalg.norm(move, axis=1).max(), rel=1e-12)]


def test_what_is_missing_may_be_small_enough():
    pushed = run(lambda cage, longest: contact(0.1), enough=0.11)
    np.testing.assert_array_equal(pushed.vertices, box().vertices)


@pytest.mark.parametrize(
    ("shares", "pushes"),
    [([1.0] * 2 * MAX_FRUITLESS_PUSHES, MAX_FRUITLESS_PUSHES), ([0.8**k for k in range(9)], 9)],
)
def test_pushes_that_stop_helping_end(shares, pushes):
    left = iter(shares)
    made = []

    def find_contacts(cage, longest):
        made.append(longest)
        share = next(left, None)
        return None if share is None else contact(0.1 * share)

    run(find_contacts)
    # The one at which the end is found pushes no more.
    assert len(made) - 1 == pushes
