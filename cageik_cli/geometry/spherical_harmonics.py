"""Real spherical harmonics of bands 1 to 3, and how their coefficients turn with a rotation.

Signs and factors are those of Gaussian splats (Kerbl et al. 2023, 3D Gaussian splatting). A
rotation R takes a function f of directions to f(Rᵀ d). A band of degree l stays in itself, and so
the coefficients of the turned function follow from its values in 2l + 1 fixed directions.

Arrays have one function per column, so that each operation runs over all of them.
"""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.util.arrays import Floats

REST_COUNTS = {(degree + 1) ** 2 - 1: degree for degree in range(4)}
"""The degree by the number of coefficients beyond the constant one."""

_DIRECTIONS = (
    ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((1, 0, 0), (0, 1, 0), (1, -1, -1), (1, -1, 1), (1, 1, -1)),
    ((1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 1, 1), (1, 0, 1), (1, -1, 0), (1, 1, -1)),
)
"""Where bands 1, 2 and 3 are sampled; the condition numbers of their values are below 2.4."""


def evaluate_band(degree: int, directions: NDArray[Any]) -> list[NDArray[Any]]:
    """Return the 2 `degree` + 1 harmonics of one band at unit directions, (3, ...), each (...)."""
    x, y, z = directions
    return (_first_band, _second_band, _third_band)[degree - 1](x, y, z)


def _first_band(x: Any, y: Any, z: Any) -> list[Any]:
    factor = 0.4886025119029199
    return [-factor * y, factor * z, -factor * x]


def _second_band(x: Any, y: Any, z: Any) -> list[Any]:
    a, b, c = 1.0925484305920792, 0.31539156525252005, 0.5462742152960396
    xx, yy = x * x, y * y
    total = xx + yy
    return [a * x * y, -a * y * z, b * (2 * z * z - total), -a * x * z, c * (xx - yy)]


def _third_band(x: Any, y: Any, z: Any) -> list[Any]:
    a, b, c = 0.5900435899266435, 2.890611442640554, 0.4570457994644658
    d, e = 0.3731763325901154, 1.445305721320277
    xx, yy, zz = x * x, y * y, z * z
    total = xx + yy
    middle = c * (4 * zz - total)
    return [
        -a * y * (3 * xx - yy),
        b * x * y * z,
        -y * middle,
        d * z * (2 * zz - 3 * total),
        -x * middle,
        e * z * (xx - yy),
        -a * x * (xx - 3 * yy),
    ]


@cache
def _samples(degree: int) -> tuple[Floats, Floats]:
    """Return unit directions, (2l + 1, 3), and the map from values there to coefficients."""
    directions = np.array(_DIRECTIONS[degree - 1], np.float64)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    values = np.stack(evaluate_band(degree, directions.T), axis=1)
    return directions, np.linalg.inv(values)


def rotate_harmonics(
    coefficients: NDArray[np.float32], rotations: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the coefficients of turned functions.

    Parameters
    ----------
    coefficients : (3, c, m) float32
        Of three colours; c is one of `REST_COUNTS`: whole bands from the first on.
    rotations : (3, 3, m) float32
    """
    turned = np.empty_like(coefficients)
    start = 0
    for degree in range(1, REST_COUNTS[coefficients.shape[1]] + 1):
        band = slice(start, start + 2 * degree + 1)
        directions, to_coefficients = _samples(degree)
        turned_back = np.tensordot(directions.astype(np.float32), rotations, 1).swapaxes(0, 1)
        values = np.zeros((2 * degree + 1, 3, coefficients.shape[2]), np.float32)
        product = np.empty_like(values)
        for i, basis in enumerate(evaluate_band(degree, turned_back)):
            values += np.multiply(basis[:, None], coefficients[:, start + i], out=product)
        found = to_coefficients.astype(np.float32) @ values.reshape(2 * degree + 1, -1)
        turned[:, band] = found.reshape(values.shape).swapaxes(0, 1)
        start = band.stop
    return turned
