"""The rotations nearest to many 3 x 3 matrices at once.

The rotation R that maximises tr(RᵀA) is the derivative of that largest value f with respect to A.
f is the largest root of

    (f² − |A|²)² = 4 |cof A|² + 8 f det A,

and its derivative follows from this equation (Horn 1987 for the quartic; Lin, Chitalu and Komura
2022 for the derivative by invariants). That takes some ten passes over all matrices together, where
singular value decompositions are one library call for each.
"""

import numpy as np

from cageik_cli.mesh import Floats

STEPS = 2
"""Of Newton's method, from half the digits or more to all."""

LEAST_SPREAD = 1e-20
"""Of the squares of singular values, squared: below, they are the same but for rounding."""

LEAST_GAP = 1e-2
"""Between the two largest roots, for |A| = 1: below, digits are lost."""


def _places(rows: int, columns: int) -> list[int]:
    """Where in a flat matrix those entries are whose rows and columns are so many further on."""
    return [3 * ((i + rows) % 3) + (j + columns) % 3 for i in range(3) for j in range(3)]


A, B, C, D = _places(1, 1), _places(2, 2), _places(1, 2), _places(2, 1)
"""cof X is X_A X_B − X_C X_D."""


def nearest_rotations(matrices: Floats) -> Floats:
    """Rotations R, (k, 3, 3), that maximise tr(RᵀA) for matrices A, (k, 3, 3); never a reflection.

    A matrix of zeros, which has none, is given the identity.
    """
    flat = np.ascontiguousarray(matrices.reshape(-1, 9).T)
    sizes = np.sqrt(_dots(flat, flat))
    flat /= np.where(sizes > 0, sizes, 1)
    cofactors = flat[A] * flat[B]
    cofactors -= flat[C] * flat[D]
    determinants, squares = _dots(flat[:3], cofactors[:3]), _dots(cofactors, cofactors)
    unit = flat.T.reshape(-1, 3, 3)
    cubes = (unit @ unit.swapaxes(1, 2) @ unit).reshape(-1, 9).T
    with np.errstate(divide="ignore", invalid="ignore"):  # roots that meet are done otherwise
        f, gap = _largest_root(determinants, squares)
        rest = f * f - 1
        slope = 4 * f * rest - 8 * determinants
        found = (4 * rest + 8) * flat
        found += 8 * (f * cofactors - cubes)
        found /= slope
    rotations = np.ascontiguousarray(found.T).reshape(-1, 3, 3)
    is_poor = ~(gap > LEAST_GAP)
    if is_poor.any():
        rotations[is_poor] = decomposed(unit[is_poor])
    return rotations


def _largest_root(determinants: Floats, squares: Floats) -> tuple[Floats, Floats]:
    """The root f for |A| = 1, det A and |cof A|², and about half its distance from the next.

    It starts from the singular values, whose squares are the roots of a cubic; of these the least
    has only half the digits when it is small.
    """
    spread = np.sqrt(np.maximum(1 - 3 * squares, LEAST_SPREAD)) / 3
    turn = (determinants * determinants - squares / 3 + 2 / 27) / (2 * spread**3)
    angle = np.arccos(np.clip(turn, -1, 1)) / 3
    first = 1 / 3 + 2 * spread * np.cos(angle)
    last = np.maximum(1 / 3 + 2 * spread * np.cos(angle + 2 * np.pi / 3), 0)
    middle = np.maximum(1 - first - last, 0)
    gap = np.sqrt(middle) + np.copysign(np.sqrt(last), determinants)
    f = np.sqrt(first) + gap
    constants, slopes = 1 - 4 * squares, 8 * determinants
    for _ in range(STEPS):
        square = f * f
        f -= (((square - 2) * f - slopes) * f + constants) / (4 * f * (square - 1) - slopes)
    return f, gap


def _dots(left: Floats, right: Floats) -> Floats:
    return np.asarray(np.einsum("ik,ik->k", left, right))


def decomposed(matrices: Floats) -> Floats:
    """The same rotations by singular values: slower, of whatever matrices.

    References
    ----------
    Kabsch 1976; Umeyama 1991 for the sign that keeps reflections out.
    """
    left, _, right = np.linalg.svd(matrices)
    left[:, :, 2] *= np.linalg.det(left @ right)[:, None]
    return np.asarray(left @ right)
