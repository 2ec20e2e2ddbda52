"""Positions in single precision, as most formats hold them."""

import numpy as np
from numpy.typing import NDArray

from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import InputError


def single_precision(positions: Floats) -> NDArray[np.float32]:
    """`positions` as contiguous float32.

    Raises
    ------
    InputError
        When one is too large for it.
    """
    with np.errstate(over="ignore"):
        singles = np.ascontiguousarray(positions, np.float32)
    if not np.isfinite(singles).all():
        raise InputError(
            f"a coordinate of {np.abs(positions).max():g} is too large for this format, which "
            "holds numbers of single precision; scale the animation, or write .npz"
        )
    return singles
