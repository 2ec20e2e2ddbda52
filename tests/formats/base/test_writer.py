"""Single precision, and what it cannot hold."""

import numpy as np
import pytest

from cageik_cli.formats.base.writers import to_float32
from cageik_cli.util.errors import OutputError


def test_positions_are_rounded_and_laid_out_in_order():
    positions = np.linspace(0, 1, 12).reshape(3, 4).T
    singles = to_float32(positions)
    assert singles.dtype == np.float32
    assert singles.flags.c_contiguous
    np.testing.assert_array_equal(singles, positions.astype(np.float32))


@pytest.mark.parametrize("largest", [3.5e38, -1e50])
def test_too_large_is_refused(largest):
    with pytest.raises(OutputError, match="too large"):
        to_float32(np.array([[0, largest, 1.0]]))


def test_the_largest_is_held():
    largest = float(np.finfo(np.float32).max)
    assert to_float32(np.array([[largest, -largest, 0]]))[0, 0] == np.float32(largest)
