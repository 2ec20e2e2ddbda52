"""Gradients of ∫ P/r dA for polynomials P beyond linear, by recurrences, for points near a panel.

With K_P = ∫ P/r dA, D_P = ∫ P h/r³ dA, the gradients ∇x and ∇y of the panel's coordinates, and

    U_x(P) = Σ_k (∇x · m_k) ∫_k P/r dl − K of ∇x · ∇P,      U_y(P) likewise,

Gauss's theorem gives, with the sides e_x and e_y along which only x or only y grows, by one,

    ∇K_P = n D_P − e_x U_x(P) − e_y U_y(P),       D_xP = x(p) D_P − h U_x(P),

and along an edge, with τ, s, ρ and lengths as in `higher_terms`,

    N_j = ∫ τ^j/r dτ = ([τ^(j−1) r] − (2j − 1) s N_(j−1) − (j − 1) ρ² N_(j−2)) / j,

where ρ² + s² is the squared distance of the edge's middle, as there.
"""

import numpy as np

from cageik_cli.coordinates.bem.higher_terms import HigherTerms, monomial_places
from cageik_cli.coordinates.bem.panel_geometry import (
    LINEAR_TERMS,
    Panels,
    monomials,
    orthogonal_basis,
)
from cageik_cli.coordinates.bem.panels import PanelView
from cageik_cli.util.arrays import Floats, Integers, Workspace


def higher_gradients(
    terms: HigherTerms,
    near: Integers,
    view: PanelView,
    moments: tuple[Floats, Floats],
    workspace: Workspace,
) -> Floats:
    """Return ∇ ∫ ψ/r of the panels `terms.high_panels[near]`, (3, d − 3, k, q).

    Parameters
    ----------
    moments : (3, p, q) and (d − 3, k, q)
        From `linear_moments` and `higher_moments`.
    """
    panels, chosen = terms.panels, terms.high_panels[near]
    linear, higher = moments
    k, q = len(near), linear.shape[2]
    basis = orthogonal_basis(terms.order)
    single = np.concatenate([linear[:, chosen], higher])
    single = (np.linalg.inv(basis) @ single.reshape(len(basis), -1)).reshape(-1, k, q)
    slopes = _slope_sums(terms, near, view, single)
    double = _double_moments(terms, chosen, view, slopes)
    parts = np.concatenate([double[None], slopes]).reshape(3, len(basis), -1)
    double, along_x, along_y = (basis[LINEAR_TERMS:] @ parts).reshape(3, -1, k, q)
    corner = panels.vertices[panels.corners[chosen]]
    found = workspace.array("higher_gradients", 3, len(higher), k, q)
    product = workspace.array("gradient_product", len(higher), k, q)
    for axis in range(3):
        np.multiply(double, panels.normals[chosen, axis, None], out=found[axis])
        for i, values in enumerate((along_x, along_y)):
            side = corner[:, i, axis] - corner[:, 2, axis]
            found[axis] -= np.multiply(values, side[:, None], out=product)
    return found


def evaluate_higher_densities(
    terms: HigherTerms, densities: Floats, chosen: Integers, barycentric: Floats
) -> Floats:
    """Return the terms beyond linear of densities at points on panels, (q, n).

    Parameters
    ----------
    densities : ((d − 3) k, n)
        Their coefficients.
    chosen : (q,) int64
        The panel of each point.
    barycentric : (3, q)
    """
    total = np.zeros((len(chosen), densities.shape[1]))
    on_high = np.flatnonzero(np.isin(chosen, terms.high_panels))
    if len(on_high) == 0:
        return total
    place = np.searchsorted(terms.high_panels, chosen[on_high])
    values = monomials(terms.order, barycentric[:, on_high].T)
    values = orthogonal_basis(terms.order)[LINEAR_TERMS:] @ values
    coefficients = densities.reshape(len(values), len(terms.high_panels), -1)
    for term, value in enumerate(values):
        total[on_high] += value[:, None] * coefficients[term, place]
    return total


def _slope_sums(terms: HigherTerms, near: Integers, view: PanelView, single: Floats) -> Floats:
    """Return U_x and U_y of all monomials, (2, d, k, q), from their K, (d, k, q)."""
    count, k, q = single.shape
    sides = terms.panels.edges.side_edges[terms.high_panels[near]]
    edges, place = np.unique(sides, return_inverse=True)
    powers = _edge_powers(terms.panels, edges, terms.order, view)[place.ravel()]
    sums = terms.gradient_factors[near] @ powers.reshape(k, -1, q)
    slopes = np.ascontiguousarray(sums.transpose(1, 0, 2)).reshape(2, count, k, q)
    places = monomial_places(terms.order)
    metric = terms.panels.metric[:, :, terms.high_panels[near], None]
    for (a, b), here in places.items():
        for power, axis, lower in ((a, 0, (a - 1, b)), (b, 1, (a, b - 1))):
            if power:
                below = power * single[places[lower]]
                slopes[0, here] -= metric[0, axis] * below
                slopes[1, here] -= metric[1, axis] * below
    return slopes


def _double_moments(
    terms: HigherTerms, chosen: Integers, view: PanelView, slopes: Floats
) -> Floats:
    """Return D of all monomials, (d, k, q)."""
    places = monomial_places(terms.order)
    height, foot = view.height[chosen], view.foot[:, chosen]
    double = np.empty(slopes.shape[1:])
    double[0] = view.solid_angle[chosen]
    for (a, b), here in list(places.items())[1:]:
        axis, lower = (0, (a - 1, b)) if a else (1, (a, b - 1))
        below = places[lower]
        np.multiply(foot[axis], double[below], out=double[here])
        double[here] -= height * slopes[axis, below]
    return double


def _edge_powers(panels: Panels, edges: Integers, order: int, view: PanelView) -> Floats:
    """Return N_0 to N_order of some edges, (k, order + 1, q)."""
    per_length = 1 / panels.edge_lengths[edges, None]
    ends = panels.edges.ends[edges]
    r_a, r_b = (view.distance[ends[:, k]] * per_length for k in (0, 1))
    middle = view.along[edges] * per_length + 0.5
    square = (r_a * r_a + r_b * r_b) / 2 - 0.25
    powers = np.empty((len(edges), order + 1, r_a.shape[1]))
    powers[:, 0] = view.edge_log[edges]
    for j in range(1, order + 1):
        found = (r_b - r_a if j % 2 else r_b + r_a) * 0.5 ** (j - 1)
        found -= (2 * j - 1) * middle * powers[:, j - 1]
        if j > 1:
            found -= (j - 1) * square * powers[:, j - 2]
        powers[:, j] = found / j
    return powers
