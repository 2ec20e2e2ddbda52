import numpy as np
import pytest

from cageik_cli.method.weights.bem.panels import (
    LINEAR_TERMS,
    edge_coefficients,
    exponents,
    gauss_rule,
    monomials,
    orthogonal_basis,
)


def test_monomials_are_counted_and_ordered_by_degree():
    assert exponents(2) == ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
    assert [len(exponents(order)) for order in range(6)] == [1, 3, 6, 10, 15, 21]


@pytest.mark.parametrize("points", [1, 2, 3, 6])
def test_the_rule_is_exact_for_products_of_barycentric_coordinates(points):
    """mean(φ_0^a φ_1^b φ_2^c) = 2 a! b! c! / (a + b + c + 2)!"""
    barycentric, shares = gauss_rule(points)
    assert (barycentric > 0).all()
    factorial = [1.0]
    for k in range(1, 20):
        factorial.append(factorial[-1] * k)
    for a, b in exponents(2 * points - 2):
        for c in range(2 * points - 1 - a - b):
            found = shares @ np.prod(barycentric ** np.array([a, b, c]), axis=1)
            exact = 2 * factorial[a] * factorial[b] * factorial[c] / factorial[a + b + c + 2]
            assert found == pytest.approx(exact, rel=1e-13)


def test_a_rule_with_one_point_less_is_not_exact():
    barycentric, shares = gauss_rule(2)
    assert shares @ barycentric[:, 0] ** 4 != pytest.approx(2 * 24 / 720, rel=1e-3)


@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_the_basis_beyond_linear_is_orthonormal_and_has_no_low_moments(order):
    barycentric, shares = gauss_rule(order + 2)
    values = orthogonal_basis(order) @ monomials(order, barycentric)
    products = (values * shares) @ values.T
    np.testing.assert_allclose(
        products[LINEAR_TERMS:, LINEAR_TERMS:], np.eye(len(values) - LINEAR_TERMS), atol=1e-10
    )
    np.testing.assert_allclose(products[LINEAR_TERMS:, :LINEAR_TERMS], 0, rtol=0, atol=1e-11)
    x, y, _ = barycentric.T - 1 / 3
    np.testing.assert_allclose(values[:LINEAR_TERMS], [np.ones_like(x), x, y], rtol=0, atol=1e-15)


def test_along_a_side_the_monomials_are_polynomials_of_its_parameter():
    order, t = 4, np.linspace(-0.5, 0.5, 7)
    for k in range(3):
        barycentric = np.zeros((7, 3))
        barycentric[:, (k + 1) % 3], barycentric[:, (k + 2) % 3] = 0.5 - t, 0.5 + t
        along = edge_coefficients(order)[k] @ t ** np.arange(order)[:, None]
        np.testing.assert_allclose(along, monomials(order - 1, barycentric), rtol=0, atol=1e-14)
