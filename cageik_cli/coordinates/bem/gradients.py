"""Gradients of harmonic weights in closed form, inside a cage.

For a panel as in `panels`, seen from x, and a polynomial P on it,

    ∇ ∫ P/r dA = n ∫ P h/r³ dA + ∫ ∇P/r dA − Σ_k m_k ∫_k P/r dl,

by Gauss's theorem in the plane. Each term is linear in integrals that the weights need, too, in

    f = ∫ 1/r dl   and   g = ∫ (s − s_a)/r dl = r_b − r_a − s_a f     of every edge ab,

and, for terms beyond linear, in those of `higher_gradients`. The double layer of a hat is a curl:
its density is continuous on a closed surface, so that (Stokes)

    ∇ ∫ φ h/r³ dA = Σ_panels (n × ∇φ) × ∇ ∫ 1/r dA.

No integral over an edge remains that grows with the inverse of the distance.

The derivative is that of the function that `boundary_equation.interior_weights` evaluates, with the
fading of higher terms. Rounding is corrected as it is in the densities: the gradients of affine
functions are known, and the least change of the gradients makes them exact.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from cageik_cli.coordinates.bem.boundary_equation import BoundarySolution, affine_values
from cageik_cli.coordinates.bem.boundary_mesh import BoundaryMesh
from cageik_cli.coordinates.bem.higher_gradients import (
    evaluate_higher_densities,
    higher_gradients,
)
from cageik_cli.coordinates.bem.higher_terms import higher_moments
from cageik_cli.coordinates.bem.panel_geometry import LINEAR_TERMS
from cageik_cli.coordinates.bem.panels import (
    PanelView,
    close_solid_angles,
    double_layer,
    linear_moments,
    panel_view,
)
from cageik_cli.coordinates.bem.potentials import (
    FADE_FACTOR,
    compute_strength,
    find_near_panels,
    thread_workspace,
)
from cageik_cli.util.arrays import Floats, Integers, Workspace


@dataclass(frozen=True, eq=False)
class WeightGradients:
    """The gradients of the weights of a solved boundary equation."""

    boundary: BoundarySolution

    def evaluate(self, points: Floats) -> Floats:
        """Return ∇w at points strictly inside, (q, 3), as (3, n, q), in units of the panels."""
        workspace = thread_workspace()
        mesh, densities = self.boundary.mesh, self.boundary.densities
        split, panels = mesh.linear_unknowns, mesh.panels
        view = panel_view(panels, points, workspace)
        close_solid_angles(view)
        linear = linear_moments(panels, view, workspace)
        integrals = self._stack_integrals(view, linear, workspace)
        moved = (self._single_layer_map @ integrals).reshape(3, split, -1)
        gradients = densities[:split].T @ moved
        gradients += (self._double_layer_map @ integrals).reshape(gradients.shape)
        near = find_near_panels(mesh, points)
        if len(near):
            higher = higher_moments(mesh.higher_terms, near, view, linear, workspace)
            moments = linear, higher
            moved = higher_gradients(mesh.higher_terms, near, view, moments, workspace)
            moved *= compute_strength(mesh, near, points, workspace)
            moved += _strength_slopes(mesh, near, points)[:, None] * higher
            chosen = densities[split:].reshape(mesh.extra_terms, len(mesh.high_panels), -1)[:, near]
            count = mesh.extra_terms * len(near)
            gradients += chosen.reshape(count, -1).T @ moved.reshape(3, count, -1)
        gradients /= 4 * np.pi
        self._enforce_affine(gradients)
        return np.asarray(gradients)

    def evaluate_on_panels(self, points: Floats, chosen: Integers) -> Floats:
        """Return the limits of ∇w from inside, (3, n, q), at points (q, 3), each on its panel.

        Along the panel it is the slope of the hats, across it the density.
        """
        mesh, panels = self.boundary.mesh, self.boundary.mesh.panels
        corner = panels.vertices[panels.corners[chosen]]
        hat_slopes = panels.hat_slopes[:, chosen]
        rise = np.einsum("kqx,qkx->kq", hat_slopes, points[:, None] - corner)
        densities = self.boundary.densities[: mesh.linear_unknowns]
        per_panel = densities.reshape(LINEAR_TERMS, len(panels.corners), -1)[:, chosen]
        barycentric = 1 + rise
        across = per_panel[0]
        across = across + per_panel[1] * (barycentric[0] - 1 / 3)[:, None]
        across += per_panel[2] * (barycentric[1] - 1 / 3)[:, None]
        across += evaluate_higher_densities(
            mesh.higher_terms,
            self.boundary.densities[mesh.linear_unknowns :],
            chosen,
            barycentric,
        )
        gradients = np.einsum("qn,qx->xnq", across, panels.normals[chosen])
        for k in range(3):
            hats = mesh.hats.evaluate(panels.corners[chosen], np.eye(3)[[k] * len(chosen)])
            gradients += np.einsum("qn,qx->xnq", hats, hat_slopes[k])
        self._enforce_affine(gradients)
        return np.asarray(gradients)

    def _stack_integrals(self, view: PanelView, linear: Floats, workspace: Workspace) -> Floats:
        """Stack ∫ (1, x, y) h/r³ and ∫ 1/r of all panels, then f and g of all edges."""
        panels = self.boundary.mesh.panels
        p, q = view.height.shape
        stacked = workspace.array("integral_stack", 4 * p + 2 * len(view.along), q)
        stacked[: 3 * p] = double_layer(panels, view, workspace).reshape(3 * p, q)
        stacked[3 * p : 4 * p] = linear[0]
        log, moment = stacked[4 * p :].reshape(2, -1, q)
        log[:] = view.edge_log
        np.multiply(view.along, view.edge_log, out=moment)
        r_a, r_b = (
            workspace.take_rows(f"end_{k}", view.distance, panels.edges.ends[:, k]) for k in (0, 1)
        )
        np.subtract(r_b, moment, out=moment)
        moment -= r_a
        return stacked

    @cached_property
    def _single_layer_map(self) -> sparse.csr_array:
        """Return the map from stacked integrals to ∇ ∫ (1, x, y)/r, (3 · 3p, 4p + 2e)."""
        panels = self.boundary.mesh.panels
        p = len(panels.corners)
        own = np.arange(p)
        entries = []
        for axis in range(3):
            for term in range(LINEAR_TERMS):
                row = (axis * LINEAR_TERMS + term) * p + own
                entries.append((row, term * p + own, panels.normals[:, axis]))
                if term:
                    entries.append((row, 3 * p + own, panels.hat_slopes[term - 1, :, axis]))
                for k in range(3):
                    side = -panels.side_normals[k, :, axis]
                    log, moment = self._edge_columns(k)
                    first, slope = self._values_on_side(term, k)
                    entries.append((row, log, side * first))
                    entries.append((row, moment, side * slope))
        return self._build_map(entries, 9 * p)

    @cached_property
    def _double_layer_map(self) -> sparse.csr_array:
        """Return the map from stacked integrals to ∇D of the hats, (3n, 4p + 2e)."""
        mesh = self.boundary.mesh
        panels = mesh.panels
        v, own = len(panels.vertices), np.arange(len(panels.corners))
        entries = []
        for i in range(3):
            turned = np.cross(panels.normals, panels.hat_slopes[i])
            for axis in range(3):
                row = axis * v + panels.corners[:, i]
                entries.append((row, own, panels.hat_slopes[i][:, axis]))
                for k in range(3):
                    side = -np.cross(turned, panels.side_normals[k])[:, axis]
                    entries.append((row, self._edge_columns(k)[0], side))
        to_hats = sparse.block_diag([mesh.hats.to_matrix().T] * 3, format="csr")
        return sparse.csr_array(to_hats @ self._build_map(entries, 3 * v))

    def _edge_columns(self, k: int) -> tuple[Integers, Integers]:
        """Return the columns of f and g of the edges at sides k, (p,) each."""
        panels = self.boundary.mesh.panels
        log = 4 * len(panels.corners) + panels.edges.side_edges[:, k]
        return log, log + len(panels.edges.ends)

    def _values_on_side(self, term: int, k: int) -> tuple[Floats, Floats]:
        """Return 1, x or y at the first end of the edge at sides k, and its slope on it, (p,)."""
        panels = self.boundary.mesh.panels
        corner_values = np.array([[1.0, 1.0, 1.0], [2.0, -1.0, -1.0], [-1.0, 2.0, -1.0]])
        corner_values /= [[1], [3], [3]]
        ends = corner_values[term, [(k + 1) % 3, (k + 2) % 3]]
        is_along = panels.edge_signs[:, k] > 0
        first, last = np.where(is_along, ends[0], ends[1]), np.where(is_along, ends[1], ends[0])
        return first, (last - first) / panels.edge_lengths[panels.edges.side_edges[:, k]]

    def _build_map(
        self, entries: list[tuple[Integers, Integers, Floats]], rows: int
    ) -> sparse.csr_array:
        """Return the sparse matrix with these (row, column, value)."""
        panels = self.boundary.mesh.panels
        row, column, value = (np.concatenate(part) for part in zip(*entries, strict=True))
        shape = (rows, 4 * len(panels.corners) + 2 * len(panels.edges.ends))
        found = sparse.csr_array((value, (row, column)), shape=shape)
        found.eliminate_zeros()
        return found

    def _enforce_affine(self, gradients: Floats) -> None:
        """Change gradients, (3, n, q), least, so that Σ_k ∇w_k = 0 and Σ_k c_k ⊗ ∇w_k = 1."""
        excess = affine_values(self.boundary.mesh).T @ gradients
        for axis in range(3):
            excess[axis, 1 + axis] -= 1
        gradients -= self.boundary.affine_correction.T @ excess


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
