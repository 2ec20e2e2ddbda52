"""The harmonic coordinates of a cage as functions of a point: their values and gradients.

Gradients inside a cage are in closed form. For a panel as in `weights.bem.panels`, seen from x, and
a polynomial P on it,

    ∇ ∫ P/r dA = n ∫ P h/r³ dA + ∫ ∇P/r dA − Σ_k m_k ∫_k P/r dl,

by Gauss's theorem in the plane. Each term is linear in integrals that the weights need, too, in

    f = ∫ 1/r dl   and   g = ∫ (s − s_a)/r dl = r_b − r_a − s_a f     of every edge ab,

and, for terms beyond linear, in those of the recurrences below. The double layer of a basis
function is a curl: its density is continuous on a closed surface, so that (Stokes)

    ∇ ∫ φ h/r³ dA = Σ_panels (n × ∇φ) × ∇ ∫ 1/r dA.

No integral over an edge remains that grows with the inverse of the distance.

Beyond linear, for points near a panel, let K_P = ∫ P/r dA, D_P = ∫ P h/r³ dA, and

    U_x(P) = Σ_k (∇x · m_k) ∫_k P/r dl − K of ∇x · ∇P,      U_y(P) likewise,

with the gradients ∇x and ∇y of the panel's coordinates. Gauss's theorem gives, with the sides e_x
and e_y along which only x or only y grows, by one,

    ∇K_P = n D_P − e_x U_x(P) − e_y U_y(P),       D_xP = x(p) D_P − h U_x(P),

and along an edge, with τ, s, ρ and lengths as in `higher_terms`,

    N_j = ∫ τ^j/r dτ = ([τ^(j−1) r] − (2j − 1) s N_(j−1) − (j − 1) ρ² N_(j−2)) / j,

where ρ² + s² is the squared distance of the edge's middle, as there.

The derivative is that of the function that `boundary_equation.interior_weights` evaluates, with the
fading of higher terms. Rounding is corrected as it is in the densities: the gradients of affine
functions are known, and the least change of the gradients makes them exact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from cageik_cli.geometry.mesh import TriMesh, validate_positions
from cageik_cli.geometry.surface import ClosestPoints, closest_points, winding_numbers
from cageik_cli.method.weights.bem.boundary_equation import (
    BoundarySolution,
    affine_values,
    interior_weights,
)
from cageik_cli.method.weights.bem.boundary_mesh import BoundaryMesh
from cageik_cli.method.weights.bem.higher_terms import HigherTerms, higher_moments, monomial_places
from cageik_cli.method.weights.bem.panels import (
    LINEAR_TERMS,
    PanelView,
    monomials,
    orthogonal_basis,
)
from cageik_cli.method.weights.bem.potentials import (
    FADE_FACTOR,
    compute_strength,
    find_near_panels,
    thread_workspace,
)
from cageik_cli.method.weights.harmonic import HarmonicSolution, check_request
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import CageError
from cageik_cli.util.progress import ignore_progress
from cageik_cli.util.text import group_digits


@dataclass(frozen=True, eq=False)
class HarmonicField:
    """The harmonic weights of a cage, as functions of a point inside or on it.

    Make one with `HarmonicField.solve`.

    Attributes
    ----------
    cage : TriMesh
        n vertices.
    solution : HarmonicSolution
        At the points that it was solved for.
    boundary : BoundarySolution
        Of the cage in its own units: centred, with a diagonal of one.
    error : float
        Estimate of the mean row L1 error at those points.

    Examples
    --------
    >>> from cageik_cli import HarmonicField, load_mesh
    >>> cage = load_mesh("data_fixtures/walker/cage.obj")
    >>> model = load_mesh("data_fixtures/walker/frames/walker_1.obj")
    >>> field = HarmonicField.solve(cage, model.vertices, accuracy="preview")
    >>> field
    <HarmonicField: a cage of 80>
    >>> gradient = field.gradient(model.vertices[:10])
    >>> gradient.shape
    (10, 80, 3)
    >>> stretch = gradient.swapaxes(1, 2) @ cage.vertices
    >>> bool(abs(stretch - [[1, 0, 0], [0, 1, 0], [0, 0, 1]]).max() < 1e-12)
    True
    """

    cage: TriMesh
    solution: HarmonicSolution

    def __repr__(self) -> str:
        return f"<HarmonicField: a cage of {len(self.cage.vertices)}>"

    @staticmethod
    def solve(
        cage: TriMesh, points: Floats, accuracy: str = "standard", jobs: int | None = None
    ) -> HarmonicField:
        """Solve for the weights of a cage, to a tolerance at given points.

        Parameters
        ----------
        cage : TriMesh
            As of `bind`, turned outward.
        points : (m, 3)
            Where the weights are wanted, file units. For the points of a `Binding`, the field
            is the one that its weights came from; those are rounded in the seventh digit.
        accuracy : str
            One of `ACCURACIES`.
        jobs : int, optional
            Threads; the number of processors by default. They do not change the result.

        Raises
        ------
        CageikError
            When the accuracy is unknown, or the cage has too many faces.
        """
        check_request(cage, accuracy)
        points = validate_positions(points)
        within = ~closest_points(cage, points).is_touching
        inside = points[within] if within.any() else points
        return HarmonicField(cage, HarmonicSolution(cage, inside, accuracy, jobs))

    @property
    def boundary(self) -> BoundarySolution:
        """Return the densities of the weights."""
        return self.solution.boundary

    @property
    def error(self) -> float:
        """Return the estimated error of the weights."""
        return self.solution.error

    def evaluate(
        self,
        points: Floats,
        jobs: int | None = None,
        progress: Callable[[int, int], None] = ignore_progress,
    ) -> Floats:
        """Return the weights of points inside or on the cage, (m, 3), as (m, n).

        A point on it has barycentric weights. `progress` is called with (points done, points).

        Raises
        ------
        CageError
            When a point is outside.
        """
        points = validate_positions(points)
        nearest = self._locate(points)
        weights = np.empty((len(points), len(self.cage.vertices)))
        weights[nearest.is_touching] = nearest.barycentric_weights(nearest.is_touching)

        def fill(chosen: Integers, places: Floats) -> None:
            weights[chosen] = interior_weights(self.boundary, places)

        within = np.flatnonzero(~nearest.is_touching)
        self.solution.visit_blocks(points, within, fill, jobs, progress)
        return weights

    def gradient(
        self,
        points: Floats,
        jobs: int | None = None,
        progress: Callable[[int, int], None] = ignore_progress,
    ) -> Floats:
        """Return the gradients of the weights at points inside or on the cage, as (m, n, 3).

        They are exact derivatives of what `evaluate` computes, per file unit. On the cage they are
        the limit from inside. Sums are exact to rounding: the gradients of a point sum to zero, and
        Σ_k c_k ⊗ ∇w_k is the identity. Memory is 24 m n bytes for the result.

        Raises
        ------
        CageError
            When a point is outside.
        """
        points = validate_positions(points)
        nearest = self._locate(points)
        gradients = np.empty((len(points), len(self.cage.vertices), 3))
        on_cage = np.flatnonzero(nearest.is_touching)
        surface = TriMesh(self.boundary.mesh.panels.vertices, self.boundary.mesh.panels.corners)
        size = 4096  # points on the cage whose gradients are computed together
        for start in range(0, len(on_cage), size):
            chosen = on_cage[start : start + size]
            places = self.solution.to_units(nearest.position[chosen])
            panels = closest_points(surface, places).face
            gradients[chosen] = self._gradients.evaluate_on_panels(places, panels).transpose(
                2, 1, 0
            )

        def fill(chosen: Integers, places: Floats) -> None:
            gradients[chosen] = self._gradients.evaluate(places).transpose(2, 1, 0)

        within = np.flatnonzero(~nearest.is_touching)
        self.solution.visit_blocks(points, within, fill, jobs, progress)
        gradients /= self.solution.scale
        return gradients

    def _locate(self, points: Floats) -> ClosestPoints:
        """Return the closest points of the cage; refuse points outside it."""
        nearest = closest_points(self.cage, points)
        within = np.flatnonzero(~nearest.is_touching)
        outside = within[winding_numbers(self.cage, points[within]) < 0.5]
        if len(outside):
            raise CageError(
                f"{group_digits(len(outside))} of {group_digits(len(points))} points are outside "
                "the cage, the first is number "
                f"{outside[0]} (from 0); take their closest points on it"
            )
        return nearest

    @cached_property
    def _gradients(self) -> WeightGradients:
        return WeightGradients(self.boundary)


class WeightGradients:
    """The gradients of the weights of a solved boundary equation."""

    def __init__(self, boundary: BoundarySolution) -> None:
        self._boundary, self._mesh, self._panels = boundary, boundary.mesh, boundary.mesh.panels
        self._linear, self._higher = np.split(boundary.densities, [boundary.mesh.linear_unknowns])

    def evaluate(self, points: Floats) -> Floats:
        """Return ∇w at points strictly inside, (q, 3), as (3, n, q), in units of the panels."""
        mesh = self._mesh
        view = PanelView(self._panels, points, thread_workspace())
        view.close_solid_angles()
        linear = view.linear_moments()
        integrals = _stack_integrals(view, linear)
        moved = (self._single_layer_map @ integrals).reshape(3, mesh.linear_unknowns, -1)
        gradients = self._linear.T @ moved
        gradients += (self._double_layer_map @ integrals).reshape(gradients.shape)
        near = find_near_panels(mesh, points)
        if len(near):
            higher = higher_moments(mesh.higher_terms, near, view, linear)
            moved = _higher_gradients(mesh.higher_terms, near, view, linear, higher)
            moved *= compute_strength(mesh, near, points, view.workspace)
            moved += _strength_slopes(mesh, near, points)[:, None] * higher
            chosen = self._higher.reshape(mesh.extra_terms, len(mesh.high_panels), -1)[:, near]
            count = mesh.extra_terms * len(near)
            gradients += chosen.reshape(count, -1).T @ moved.reshape(3, count, -1)
        gradients /= 4 * np.pi
        self._enforce_affine(gradients)
        return np.asarray(gradients)

    def evaluate_on_panels(self, points: Floats, chosen: Integers) -> Floats:
        """Return the limits of ∇w from inside, (3, n, q), at points (q, 3), each on its panel.

        Along the panel it is the slope of the basis functions, across it the density.
        """
        mesh, panels = self._mesh, self._panels
        corner = panels.vertices[panels.corners[chosen]]
        basis_slopes = panels.basis_slopes[:, chosen]
        rise = np.einsum("kqx,qkx->kq", basis_slopes, points[:, None] - corner)
        per_panel = self._linear.reshape(LINEAR_TERMS, len(panels.corners), -1)[:, chosen]
        barycentric = 1 + rise
        across = per_panel[0]
        across = across + per_panel[1] * (barycentric[0] - 1 / 3)[:, None]
        across += per_panel[2] * (barycentric[1] - 1 / 3)[:, None]
        across += _evaluate_higher_densities(mesh.higher_terms, self._higher, chosen, barycentric)
        gradients = np.einsum("qn,qx->xnq", across, panels.normals[chosen])
        for k in range(3):
            basis_functions = mesh.basis_functions.evaluate(
                panels.corners[chosen], np.eye(3)[[k] * len(chosen)]
            )
            gradients += np.einsum("qn,qx->xnq", basis_functions, basis_slopes[k])
        self._enforce_affine(gradients)
        return np.asarray(gradients)

    @cached_property
    def _single_layer_map(self) -> sparse.csr_array:
        """Return the map from stacked integrals to ∇ ∫ (1, x, y)/r, (3 · 3p, 4p + 2e)."""
        panels = self._panels
        p = len(panels.corners)
        own = np.arange(p)
        corner_values = np.array([[1.0, 1.0, 1.0], [2.0, -1.0, -1.0], [-1.0, 2.0, -1.0]])
        corner_values /= [[1], [3], [3]]
        entries = []
        for axis in range(3):
            for term in range(LINEAR_TERMS):
                row = (axis * LINEAR_TERMS + term) * p + own
                entries.append((row, term * p + own, panels.normals[:, axis]))
                if term:
                    entries.append((row, 3 * p + own, panels.basis_slopes[term - 1, :, axis]))
                for k in range(3):
                    side = -panels.side_normals[k, :, axis]
                    log, moment = self._edge_columns(k)
                    # The term, 1, x or y, at the first end of the edge, and its slope along it.
                    ends = corner_values[term, [(k + 1) % 3, (k + 2) % 3]]
                    is_along = panels.edge_signs[:, k] > 0
                    first, last = np.where(is_along, *ends), np.where(is_along, *ends[::-1])
                    length = panels.edge_lengths[panels.edges.side_edges[:, k]]
                    entries.append((row, log, side * first))
                    entries.append((row, moment, side * ((last - first) / length)))
        return self._build_map(entries, 9 * p)

    @cached_property
    def _double_layer_map(self) -> sparse.csr_array:
        """Return the map from stacked integrals to ∇D of the basis functions, (3n, 4p + 2e)."""
        mesh, panels = self._mesh, self._panels
        v, own = len(panels.vertices), np.arange(len(panels.corners))
        entries = []
        for i in range(3):
            turned = np.cross(panels.normals, panels.basis_slopes[i])
            for axis in range(3):
                row = axis * v + panels.corners[:, i]
                entries.append((row, own, panels.basis_slopes[i][:, axis]))
                for k in range(3):
                    side = -np.cross(turned, panels.side_normals[k])[:, axis]
                    entries.append((row, self._edge_columns(k)[0], side))
        to_basis = sparse.block_diag([mesh.basis_functions.to_matrix().T] * 3, format="csr")
        return sparse.csr_array(to_basis @ self._build_map(entries, 3 * v))

    def _edge_columns(self, k: int) -> tuple[Integers, Integers]:
        """Return the columns of f and g of the edges at sides k, (p,) each."""
        panels = self._panels
        log = 4 * len(panels.corners) + panels.edges.side_edges[:, k]
        return log, log + len(panels.edges.ends)

    def _build_map(
        self, entries: list[tuple[Integers, Integers, Floats]], rows: int
    ) -> sparse.csr_array:
        """Return the sparse matrix with these (row, column, value)."""
        panels = self._panels
        row, column, value = (np.concatenate(part) for part in zip(*entries, strict=True))
        shape = (rows, 4 * len(panels.corners) + 2 * len(panels.edges.ends))
        found = sparse.csr_array((value, (row, column)), shape=shape)
        found.eliminate_zeros()
        return found

    def _enforce_affine(self, gradients: Floats) -> None:
        """Change gradients, (3, n, q), least, so that Σ_k ∇w_k = 0 and Σ_k c_k ⊗ ∇w_k = 1."""
        excess = affine_values(self._mesh).T @ gradients
        for axis in range(3):
            excess[axis, 1 + axis] -= 1
        gradients -= self._boundary.affine_correction.T @ excess


def _strength_slopes(mesh: BoundaryMesh, near: Integers, points: Floats) -> Floats:
    """Return the gradients of the strengths of higher terms, (3, c, q); see `compute_strength`."""
    offset = points.T[:, None] - mesh.panels.centroids[mesh.high_panels[near]].T[:, :, None]
    distance = np.sqrt(np.einsum("xcq,xcq->cq", offset, offset))
    reach, width = mesh.reach[near, None], FADE_FACTOR - 1 / FADE_FACTOR
    share = np.clip((FADE_FACTOR - distance / reach) / width, 0, 1)
    slope = np.zeros_like(share)
    is_fading = (share > 0) & (share < 1)
    np.divide(-6 * share * (1 - share), reach * width * distance, out=slope, where=is_fading)
    return np.asarray(offset * slope)


def _stack_integrals(view: PanelView, linear: Floats) -> Floats:
    """Stack ∫ (1, x, y) h/r³ and ∫ 1/r of all panels, then f and g of all edges."""
    p, q = view.height.shape
    stacked = view.workspace.array("integral_stack", 4 * p + 2 * len(view.along), q)
    stacked[: 3 * p] = view.double_layer().reshape(3 * p, q)
    stacked[3 * p : 4 * p] = linear[0]
    log, moment = stacked[4 * p :].reshape(2, -1, q)
    log[:] = view.edge_log
    np.multiply(view.along, view.edge_log, out=moment)
    ends = view.panels.edges.ends
    r_a, r_b = (view.workspace.take_rows(f"end_{k}", view.distance, ends[:, k]) for k in (0, 1))
    np.subtract(r_b, moment, out=moment)
    moment -= r_a
    return stacked


def _higher_gradients(
    terms: HigherTerms, near: Integers, view: PanelView, linear: Floats, higher: Floats
) -> Floats:
    """Return ∇ ∫ ψ/r of the panels `terms.high_panels[near]`, (3, d − 3, k, q).

    Parameters
    ----------
    linear, higher : (3, p, q) and (d − 3, k, q)
        From `linear_moments` and `higher_moments`.
    """
    panels, chosen = terms.panels, terms.high_panels[near]
    k, q = len(near), linear.shape[2]
    basis = orthogonal_basis(terms.order)
    single = np.concatenate([linear[:, chosen], higher])
    single = (np.linalg.inv(basis) @ single.reshape(len(basis), -1)).reshape(-1, k, q)
    slopes = _slope_sums(terms, near, view, single)
    double = _double_moments(terms, chosen, view, slopes)
    parts = np.concatenate([double[None], slopes]).reshape(3, len(basis), -1)
    double, along_x, along_y = (basis[LINEAR_TERMS:] @ parts).reshape(3, -1, k, q)
    corner = panels.vertices[panels.corners[chosen]]
    found = view.workspace.array("higher_gradients", 3, len(higher), k, q)
    product = view.workspace.array("gradient_product", len(higher), k, q)
    for axis in range(3):
        np.multiply(double, panels.normals[chosen, axis, None], out=found[axis])
        for i, values in enumerate((along_x, along_y)):
            side = corner[:, i, axis] - corner[:, 2, axis]
            found[axis] -= np.multiply(values, side[:, None], out=product)
    return found


def _evaluate_higher_densities(
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
    powers = _edge_powers(edges, terms.order, view)[place.ravel()]
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


def _edge_powers(edges: Integers, order: int, view: PanelView) -> Floats:
    """Return N_0 to N_order of some edges, (k, order + 1, q)."""
    panels = view.panels
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
