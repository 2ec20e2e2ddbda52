"""Polynomials on a triangle and a quadrature rule for them, in barycentric coordinates.

The coordinates are x = φ_0 − ⅓ and y = φ_1 − ⅓, from the centroid; the monomials x^a y^b have
the order 1, x, y, x², xy, y², x³, ... Nothing here depends on the triangle's shape.
"""

from functools import cache

import numpy as np

from cageik_cli.util.arrays import Floats

LINEAR_TERMS = 3
"""Number of monomials that are constant or linear."""


@cache
def exponents(order: int) -> tuple[tuple[int, int], ...]:
    """Return (a, b) of the (order + 1)(order + 2)/2 monomials x^a y^b up to degree `order`."""
    return tuple(e for degree in range(order + 1) for e in exponents_at_degree(degree))


def exponents_at_degree(degree: int) -> tuple[tuple[int, int], ...]:
    """Return (a, b) of the monomials of one degree."""
    return tuple((degree - b, b) for b in range(degree + 1))


def monomials(order: int, barycentric: Floats) -> Floats:
    """Return the values of the monomials at `barycentric`, (k, 3), as (d, k)."""
    x, y, _ = barycentric.T - 1 / 3
    return np.stack([x**a * y**b for a, b in exponents(order)])


@cache
def orthogonal_basis(order: int) -> Floats:
    """Return 1, x, y, then polynomials of mean square 1 orthogonal to all before, (d, d).

    Each row holds the coefficients of the monomials. Polynomials after the first three have zero
    mean and first moments, so that their potentials decay with the cube of the distance.
    """
    barycentric, shares = gauss_rule(order + 1)
    values = monomials(order, barycentric)
    orthonormal = np.linalg.inv(np.linalg.cholesky((values * shares) @ values.T))
    orthonormal[:LINEAR_TERMS] = np.eye(LINEAR_TERMS, len(orthonormal))
    return np.asarray(orthonormal)


@cache
def gauss_rule(points: int) -> tuple[Floats, Floats]:
    """Return a product rule of `points` times `points` nodes, exact to degree 2 points − 2.

    Returns
    -------
    (points², 3)
        Barycentric coordinates, all inside.
    (points²,)
        Shares of the area; the sum is 1.
    """
    along, along_shares = np.polynomial.legendre.leggauss(points)
    across, across_shares = _gauss_jacobi(points)
    first = np.repeat((across + 1) / 2, points)
    second = (1 - first) * np.tile((along + 1) / 2, points)
    shares = np.outer(across_shares, along_shares).ravel() / 4
    return np.column_stack([first, second, 1 - first - second]), shares


def _gauss_jacobi(points: int) -> tuple[Floats, Floats]:
    """Return the nodes and weights of Gauss's rule for ∫ (1 − x) f(x) dx over −1 to 1.

    They are eigenvalues of the matrix of the recurrence of Jacobi's polynomials (Golub and Welsch
    1969).
    """
    k = np.arange(points)
    matrix = np.diag(-1.0 / ((2 * k + 1) * (2 * k + 3)))
    beside = np.sqrt(k[1:] * (k[1:] + 1.0)) / (2 * k[1:] + 1)
    nodes, vectors = np.linalg.eigh(matrix + np.diag(beside, 1) + np.diag(beside, -1))
    return nodes, 2 * vectors[0] ** 2


@cache
def edge_coefficients(order: int) -> Floats:
    """Return the monomials of degree below `order` along the sides, (3, d, order).

    On side k, from corner k + 1 at τ = −½ to corner k + 2 at τ = ½, monomial i is
    Σ_j coefficients[k, i, j] τ^j.
    """
    ends = np.eye(3) - 1 / 3
    coefficients = np.zeros((3, len(exponents(order - 1)), order))
    for k in range(3):
        start, stop = ends[(k + 1) % 3], ends[(k + 2) % 3]
        x, y = (np.poly1d([stop[c] - start[c], (stop[c] + start[c]) / 2]) for c in (0, 1))
        for i, (a, b) in enumerate(exponents(order - 1)):
            along = (x**a * y**b).coeffs[::-1]
            coefficients[k, i, : len(along)] = along
    return coefficients
