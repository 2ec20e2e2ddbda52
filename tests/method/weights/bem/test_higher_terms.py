import numpy as np
import pytest

from cageik_cli.method.weights.bem.higher_terms import HigherTerms, higher_moments
from cageik_cli.method.weights.bem.panels import (
    LINEAR_TERMS,
    PanelView,
    monomials,
    orthogonal_basis,
)
from cageik_cli.util.arrays import Workspace


@pytest.mark.parametrize(("order", "digits"), [(2, 1e-11), (3, 1e-10), (5, 1e-6)])
def test_higher_moments_equal_quadrature(seen, order, digits):
    """Seen from one to some ten panels away, at which some digits are lost, as is said."""
    panels, points, _, barycentric, single, _ = seen
    polynomials = orthogonal_basis(order)[LINEAR_TERMS:] @ monomials(order, barycentric)
    terms = HigherTerms(panels, np.array([0, 3, 5, 11, len(panels.corners) - 1]), order)
    near, looked = np.array([0, 2, 4]), PanelView(panels, points[:7], Workspace())
    expected = np.einsum("pqg,dg->dpq", single[terms.high_panels[near], :7], polynomials)
    found = higher_moments(terms, near, looked, looked.linear_moments())
    np.testing.assert_allclose(found, expected, rtol=0, atol=digits)
