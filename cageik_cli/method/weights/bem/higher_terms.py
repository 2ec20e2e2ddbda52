"""Closed-form ∫ P/r dA of polynomials P beyond linear, by recurrences, for points near a panel.

For a polynomial P in x and y, let K_P = ∫ P/r dA and R_P = ∫ P r dA. From
∇r = (y − p)/r and ∇ · ((y − p) P r), by Gauss's theorem in the plane,

    K_xP          = x(p) K_P + Σ_k (∇x · m_k) ∫_k P r dl − R of ∇x · ∇P
    (3 + deg) R_P = h² K_P + Σ_k t_k ∫_k P r dl + R of x(p) ∂P/∂x + y(p) ∂P/∂y

and along an edge, with τ from −½ to ½, s and ρ those of its middle, and all lengths divided by L,

    J_j = ∫ τ^j r dτ = ([τ^(j−1) r³] − (2j + 1) s J_(j−1) − (j − 1) ρ² J_(j−2)) / (j + 2).

Symbols and array layouts are those of `panels`.
"""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from cageik_cli.method.weights.bem.panels import (
    LINEAR_TERMS,
    Panels,
    PanelView,
    edge_coefficients,
    exponents,
    exponents_at_degree,
    orthogonal_basis,
)
from cageik_cli.util.arrays import Floats, Integers

_ALONG_X, _ALONG_Y, _RADIAL, _RADIAL_X, _RADIAL_Y = range(5)
"""Kinds of side sums."""


@dataclass(frozen=True, eq=False)
class HigherTerms:
    """Panels with density terms beyond linear: those of `orthogonal_basis` from the fourth on.

    Attributes
    ----------
    high_panels : (k,) int64
        Numbers of the panels.
    order : int
        Two or more.
    """

    panels: Panels
    high_panels: Integers
    order: int

    @cached_property
    def side_factors(self) -> Floats:
        """Return the maps from J of the sides, [side, power], to all side sums, (k, s, 3 order)."""
        panels, chosen, order = self.panels, self.high_panels, self.order
        altitudes = panels.altitudes[:, chosen]
        scale = np.zeros((5, 3, len(chosen)))
        scale[_ALONG_X], scale[_ALONG_Y] = panels.slopes[:2, :, chosen]
        # Σ_k t_k ∫_k, where t_k = A_k φ_k(p), in powers of the foot's x and y
        scale[_RADIAL] = altitudes / 3
        scale[_RADIAL_X, 0], scale[_RADIAL_Y, 1] = altitudes[:2]
        scale[_RADIAL_X, 2] = scale[_RADIAL_Y, 2] = -altitudes[2]
        scale *= panels.edge_lengths[panels.edges.side_edges[chosen]].T ** 2
        signs = panels.edge_signs[chosen][:, :, None] ** np.arange(order)
        kinds, monomial = np.array(list(_side_sum_places(order))).T
        along = edge_coefficients(order)[:, monomial]
        factors = np.einsum("rsk,srj,ksj->krsj", scale[kinds], along, signs)
        return np.asarray(factors.reshape(len(chosen), len(kinds), 3 * order))

    @cached_property
    def gradient_factors(self) -> Floats:
        """Return the maps from N of `higher_gradients` to Σ_k (∇x, ∇y) · m_k ∫_k P/r.

        They are (k, 2d, 3 order + 3).
        """
        panels, chosen = self.panels, self.high_panels
        along = edge_coefficients(self.order + 1)
        powers = np.arange(self.order + 1)
        signs = panels.edge_signs[chosen][:, :, None] ** powers
        slopes = panels.slopes[:2][:, :, chosen]
        factors = np.einsum("xsk,sdj,ksj->kxdsj", slopes, along, signs)
        return np.asarray(factors.reshape(len(chosen), 2 * along.shape[1], -1))


@cache
def monomial_places(order: int) -> dict[tuple[int, int], int]:
    """Return the index of each monomial x^a y^b by (a, b)."""
    return {exponent: i for i, exponent in enumerate(exponents(order))}


@cache
def _side_sum_places(order: int) -> dict[tuple[int, int], int]:
    """Return the index of each side sum that the recurrences use, by (kind, monomial)."""
    place = monomial_places(order - 1)
    wanted = []
    for degree in range(2, order + 1):
        kinds = (_RADIAL, _RADIAL_X, _RADIAL_Y)
        wanted += [(kind, place[e]) for e in exponents_at_degree(degree - 2) for kind in kinds]
        wanted += [(_ALONG_X, place[e]) for e in exponents_at_degree(degree - 1)]
        wanted.append((_ALONG_Y, place[0, degree - 1]))
    return {entry: i for i, entry in enumerate(wanted)}


def higher_moments(terms: HigherTerms, near: Integers, view: PanelView, linear: Floats) -> Floats:
    """Return ∫ ψ / r dA of the panels `terms.high_panels[near]`, (d − 3, k, q), in the workspace.

    The recurrences lose digits like (distance / panel size) to the power 2 `order`: they are for
    points near the panel.

    Parameters
    ----------
    view : PanelView
        Of all panels.
    linear : (3, p, q)
        Its linear moments.
    """
    order = terms.order
    recurrences = _Recurrences(terms, near, view, linear)
    for degree in range(2, order + 1):
        recurrences.fill_radial(degree - 2)
        recurrences.fill_single(degree)
    single = recurrences.single
    count, k, q = single.shape
    moments = view.workspace.array("higher", count - LINEAR_TERMS, k, q)
    np.matmul(
        orthogonal_basis(order)[LINEAR_TERMS:],
        single.reshape(count, -1),
        out=moments.reshape(-1, k * q),
    )
    return moments


class _Recurrences:
    """K and R of the monomials on k panels, for q points, from low degrees to higher ones.

    Attributes
    ----------
    single : (d, k, q)
        K_P of the monomials; those up to linear are given.
    """

    def __init__(self, terms: HigherTerms, near: Integers, view: PanelView, linear: Floats) -> None:
        workspace, chosen = view.workspace, terms.high_panels[near]
        k, q = len(near), linear.shape[2]
        self._places = monomial_places(terms.order)
        self._sum_places = _side_sum_places(terms.order)
        sides = terms.panels.edges.side_edges[chosen]
        edges, place = np.unique(sides, return_inverse=True)
        powers = _edge_powers(edges, terms.order, view)
        gathered = workspace.array("powers", 3 * k, terms.order, q)
        np.take(powers, place.ravel(), axis=0, out=gathered, mode="clip")
        factors = terms.side_factors[near]
        # All side sums of `_side_sum_places`, (k, s, q).
        self._sums = np.matmul(
            factors,
            gathered.reshape(k, 3 * terms.order, q),
            out=workspace.array("sums", k, factors.shape[1], q),
        )
        self._foot = [workspace.take_rows(f"near_{i}", view.foot[i], chosen) for i in (0, 1)]
        self._square = workspace.take_rows("near_h", view.height, chosen)
        self._square *= self._square
        self._metric = terms.panels.metric[:, :, chosen, None]
        # R is needed up to degree `order` − 2.
        self._radial = workspace.array("radial", len(exponents(terms.order - 2)), k, q)
        self._product = workspace.array("near_product", k, q)
        self.single = workspace.array("single", len(exponents(terms.order)), k, q)
        np.take(linear, chosen, axis=1, out=self.single[:LINEAR_TERMS], mode="clip")

    def fill_radial(self, degree: int) -> None:
        """Compute R of the monomials of one degree, from K of this degree."""
        place, sum_places = self._places, self._sum_places
        for a, b in exponents_at_degree(degree):
            here = place[a, b]
            found = np.multiply(self._square, self.single[here], out=self._radial[here])
            found += self._sums[:, sum_places[_RADIAL, here]]
            self._add_product(found, self._foot[0], self._sums[:, sum_places[_RADIAL_X, here]])
            self._add_product(found, self._foot[1], self._sums[:, sum_places[_RADIAL_Y, here]])
            for times, axis, lower in ((a, 0, (a - 1, b)), (b, 1, (a, b - 1))):
                for _ in range(times):
                    self._add_product(found, self._foot[axis], self._radial[place[lower]])
            found /= 3 + degree

    def fill_single(self, degree: int) -> None:
        """Compute K of the monomials of one degree, from K and R of lower degrees."""
        place, sum_places = self._places, self._sum_places
        for a, b in exponents_at_degree(degree):
            axis, below = (0, (a - 1, b)) if a else (1, (a, b - 1))
            here = place[below]
            found = np.multiply(self._foot[axis], self.single[here], out=self.single[place[a, b]])
            found += self._sums[:, sum_places[(_ALONG_X, _ALONG_Y)[axis], here]]
            c, d = below
            for times, other, lower in ((c, 0, (c - 1, d)), (d, 1, (c, d - 1))):
                if times:
                    factor = -times * self._metric[axis, other]
                    self._add_product(found, factor, self._radial[place[lower]])

    def _add_product(self, total: Floats, first: Floats, second: Floats) -> None:
        np.add(total, np.multiply(first, second, out=self._product), out=total)


def _edge_powers(edges: Integers, order: int, view: PanelView) -> Floats:
    """Return J_0 to J_(order − 1) of some edges, (k, order, q)."""
    panels, workspace = view.panels, view.workspace
    per_length = 1 / panels.edge_lengths[edges, None]
    ends = panels.edges.ends[edges]
    r_a, r_b = (workspace.take_rows(f"near_r_{k}", view.distance, ends[:, k]) for k in (0, 1))
    middle = workspace.take_rows("near_s", view.along, edges)
    for array in (r_a, r_b, middle):
        array *= per_length
    middle += 0.5
    powers = workspace.array("edge_powers", len(edges), order, r_a.shape[1])
    moment = workspace.take_rows("near_cube", view.edge_moment, edges)
    np.multiply(moment, per_length**2 / 2, out=powers[:, 0])
    square = np.multiply(r_a, r_a, out=workspace.array("near_square", *r_a.shape))
    r_a *= square
    cube = np.multiply(r_b, r_b, out=workspace.array("near_cube", *r_a.shape))
    square += cube
    r_b *= cube
    square /= 2
    square -= 0.25
    for j in range(1, order):
        ends_meet = np.subtract if j % 2 else np.add
        found = ends_meet(r_b, r_a, out=powers[:, j])
        found *= 0.5 ** (j - 1) / (j + 2)
        for array, factor, lower in ((middle, 2 * j + 1, j - 1), (square, j - 1, j - 2)):
            if factor:
                term = np.multiply(array, powers[:, lower], out=cube)
                term *= factor / (j + 2)
                found -= term
    return powers
