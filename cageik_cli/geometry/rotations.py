"""The rotations nearest to many 3 x 3 matrices at once.

The rotation R that maximises tr(RᵀA) is the derivative of that largest value f with respect to A.
For |A| = 1, with g = f² − 1, f is the largest root of

    g² = 4 |cof A|² + 8 f det A

(Horn 1987), and from the same equation for any |A| comes its derivative

    R = (½ g A + f cof A + A × cof A) / (½ f g − det A),

where A × B is the derivative of cof A towards B (compare Lin, Chitalu and Komura 2022). That takes
some fifty passes over all matrices together, where singular value decompositions are one library
call for each.
"""

import numpy as np

from cageik_cli.util.arrays import Floats, Mask

UP_TURNS = {
    ("Z", "Y"): np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    ("Y", "Z"): np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
}
"""What turns rows from one up axis to the other: by 90° about x, as all programs do."""

MAX_LAST_NEWTON_STEP = 1e-9
"""Largest last step of f; a next step would be a multiple of its square."""

MIN_ROOT_SLOPE = 0.03
"""Smallest ½ f g − det A; below it the next root is close, and digits are lost."""

MIN_MATRIX_NORM = 1e-140
"""Matrices of a smaller norm lose digits when the norm is squared."""

FACTOR_INDICES = np.array(
    [
        3 * ((i + down) % 3) + (j + right) % 3
        for down, right in ((1, 1), (2, 2), (1, 2), (2, 1))
        for i in range(3)
        for j in range(3)
    ]
)
"""Where in a flat matrix the factors of the nine cofactors are: A₀ A₁ − A₂ A₃."""

PARTNER_INDICES = FACTOR_INDICES.reshape(2, 2, 9)[:, ::-1].ravel()
"""The index that each factor is multiplied with."""


def are_rotations(matrices: Floats) -> Mask:
    """Return which of k matrices, (k, 3, 3), are rotations: R Rᵀ = 1 within 1e-9, det R > 0."""
    with np.errstate(over="ignore", invalid="ignore"):
        products = matrices @ matrices.swapaxes(1, 2)
        is_orthogonal = np.all(np.abs(products - np.eye(3)) < 1e-9, axis=(1, 2))
        held = np.where(is_orthogonal[:, None, None], matrices, 0)
        return np.asarray(is_orthogonal & (np.linalg.det(held) > 0))


def nearest_rotations_by_entry(entries: Floats) -> Floats:
    """Return the rotations R that maximise tr(RᵀA) for matrices A; entry by entry, (9, k).

    Never a reflection. A matrix of zeros gives the identity.
    """
    with np.errstate(all="ignore"):  # the SVD replaces what fails here
        sizes = np.sqrt(_column_dots(entries, entries))
        unit = entries / sizes
        factors = unit.take(FACTOR_INDICES, axis=0).reshape(4, 9, -1)
        cofactors = factors[0] * factors[1]
        cofactors -= factors[2] * factors[3]
        determinants, squares = (
            _column_dots(unit[:3], cofactors[:3]),
            _column_dots(cofactors, cofactors),
        )
        f, last_step = _largest_root(determinants, squares)
        half_g = (f * f - 1) / 2
        slopes = f * half_g - determinants
        factors *= cofactors.take(PARTNER_INDICES, axis=0).reshape(4, 9, -1)
        found = unit * half_g
        found += cofactors * f
        found += factors[0]
        found += factors[1]
        found -= factors[2]
        found -= factors[3]
        found /= slopes
        is_found = (
            (slopes > MIN_ROOT_SLOPE)
            & (last_step < MAX_LAST_NEWTON_STEP)
            & (sizes > MIN_MATRIX_NORM)
        )
    if not is_found.all():
        others = entries[:, ~is_found].T.reshape(-1, 3, 3)
        found[:, ~is_found] = nearest_rotations_by_svd(others).reshape(-1, 9).T
    return np.asarray(found)


def _largest_root(determinants: Floats, squares: Floats) -> tuple[Floats, Floats]:
    """Return the largest root f for |A| = 1, det A and |cof A|², and the size of the last step.

    Newton's method starts above the root, from where it always finds the largest: f is between 1
    and √3, which bounds the last term of the equation.
    """
    linear, constant = 8 * determinants, 4 * squares
    bounds = constant + np.maximum(linear, np.sqrt(3) * linear)
    f = np.sqrt(1 + np.sqrt(np.maximum(bounds, 0)))
    constant -= 1
    for _ in range(4):  # two or three steps suffice unless the matrix is a reflection
        # The polynomial ((f² − 2) f − linear) f − constant and its derivative, in few passes.
        slope = f * f
        slope -= 2
        slope *= f
        step = slope - linear
        step *= f
        step -= constant
        slope += f
        slope *= 4
        slope -= linear
        step /= slope
        f -= step
    return f, np.abs(step)


def _column_dots(left: Floats, right: Floats) -> Floats:
    return np.asarray(np.add.reduce(left * right, axis=0))


def nearest_rotations_by_svd(matrices: Floats) -> Floats:
    """Return the same rotations, (k, 3, 3), by singular value decomposition: slower, for any.

    References
    ----------
    Kabsch 1976; Umeyama 1991 for the sign that keeps reflections out.
    """
    left, _, right = np.linalg.svd(matrices)
    left[:, :, 2] *= np.linalg.det(left @ right)[:, None]
    return np.asarray(left @ right)
