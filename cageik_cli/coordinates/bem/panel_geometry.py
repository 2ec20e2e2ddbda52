"""Flat triangular panels and what closed-form integrals over them need, computed once.

Side k of a panel lies opposite its corner k; m_k is its outward normal in the panel's plane, A_k
the corner's altitude over it, n the panel's unit normal, φ_k the hat of corner k.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from cageik_cli.geometry.mesh import Edges
from cageik_cli.util.arrays import Floats, Integers


@dataclass(frozen=True, eq=False)
class Panels:
    """Flat triangles that share vertices and edges, with what the integrals need of each.

    Attributes
    ----------
    vertices : (v, 3) float64
        Of a size near one: the tolerances of the integrals are absolute.
    corners : (p, 3) int64
        Vertices of each panel, counter-clockwise seen from outside.
    """

    vertices: Floats
    corners: Integers

    @cached_property
    def edges(self) -> Edges:
        """The panels' edges; side k of a panel is opposite its corner k."""
        return Edges.from_faces(self.corners)

    @cached_property
    def edge_lengths(self) -> Floats:
        """L of each edge, (e,)."""
        return np.asarray(np.linalg.norm(np.ptp(self.vertices[self.edges.ends], axis=1), axis=1))

    @cached_property
    def normals(self) -> Floats:
        """Unit outward normals n, (p, 3)."""
        return np.asarray(self._area_vectors / (2 * self.areas[:, None]))

    @cached_property
    def areas(self) -> Floats:
        """Areas, (p,)."""
        return np.asarray(np.linalg.norm(self._area_vectors, axis=1) / 2)

    @cached_property
    def side_normals(self) -> Floats:
        """Outward in-plane unit normals m_k of the sides, (3, p, 3)."""
        normals = np.cross(self._sides, self.normals)
        return np.asarray(normals / np.linalg.norm(normals, axis=2, keepdims=True))

    @cached_property
    def altitudes(self) -> Floats:
        """Distance A_k of each corner from the opposite side, (3, p)."""
        return np.asarray(2 * self.areas / np.linalg.norm(self._sides, axis=2))

    @cached_property
    def slopes(self) -> Floats:
        """∇φ_i · m_k, (3, 3, p) indexed [i, k]; ∇φ_i = −m_i / A_i."""
        cosines = np.einsum("ipx,kpx->ikp", self.side_normals, self.side_normals)
        return np.asarray(-cosines / self.altitudes[:, None])

    @cached_property
    def metric(self) -> Floats:
        """∇φ_i · ∇φ_j of the first two hats, (2, 2, p)."""
        gradients = -self.side_normals[:2] / self.altitudes[:2, :, None]
        return np.asarray(np.einsum("ipx,jpx->ijp", gradients, gradients))

    @cached_property
    def centroids(self) -> Floats:
        """Mean of the corners, (p, 3)."""
        return np.asarray(self.vertices[self.corners].mean(axis=1))

    @cached_property
    def radii(self) -> Floats:
        """Distance of the furthest corner from the centroid, (p,)."""
        corner = self.vertices[self.corners]
        return np.asarray(np.linalg.norm(corner - self.centroids[:, None], axis=2).max(axis=1))

    @cached_property
    def edge_signs(self) -> Floats:
        """1 where side k runs along its edge, corner k + 1 first, −1 where against, (p, 3)."""
        starts = np.roll(self.corners, -1, axis=1)
        return np.where(starts == self.edges.ends[self.edges.side_edges, 0], 1.0, -1.0)

    @cached_property
    def altitude_sums(self) -> sparse.csr_array:
        """From edges to Σ A_k / 3, A_0 − A_2 and A_1 − A_2 of their values, (3p, e).

        With t_k = A_k φ_k(p), the three of f and 1, x, y of the foot make Σ_k t_k f_k.
        """
        zero, (a, b, c) = np.zeros(len(self.corners)), self.altitudes
        return self._build_side_sums(
            np.array([[a / 3, b / 3, c / 3], [a, zero, -c], [zero, b, -c]])
        )

    @cached_property
    def half_slope_sums(self) -> sparse.csr_array:
        """From edges to ½ Σ_k (∇x · m_k) and ½ Σ_k (∇y · m_k) of their values, (2p, e)."""
        return self._build_side_sums(self.slopes[:2] / 2)

    def _build_side_sums(self, factors: Floats) -> sparse.csr_array:
        """Sums over a panel's sides, with `factors` (sums, 3, p): (sums p, e)."""
        count = len(factors) * len(self.corners)
        rows = np.broadcast_to(np.arange(count).reshape(len(factors), 1, -1), factors.shape)
        columns = np.broadcast_to(self.edges.side_edges.T, factors.shape)
        used = factors != 0
        shape = (count, len(self.edges.ends))
        return sparse.csr_array((factors[used], (rows[used], columns[used])), shape=shape)

    @cached_property
    def linear_forms(self) -> Floats:
        """Linear forms of (x, 1), (3p + e, 4).

        For every panel h and the foot's coordinates x, y (see `polynomials`), then s of every
        edge's first end.
        """
        first, last = self.vertices[self.edges.ends].swapaxes(0, 1)
        tangents = (last - first) / self.edge_lengths[:, None]
        corner = self.vertices[self.corners].swapaxes(0, 1)
        gradients = -self.side_normals[:2] / self.altitudes[:2, :, None]
        anchored = [
            (self.normals, corner[0]),
            *((-gradient, self.centroids) for gradient in gradients),
            (tangents, first),
        ]
        return np.concatenate(
            [np.column_stack([-n, np.einsum("ix,ix->i", n, a)]) for n, a in anchored]
        )

    @cached_property
    def _sides(self) -> Floats:
        corner = self.vertices[self.corners].swapaxes(0, 1)
        return np.roll(corner, -2, axis=0) - np.roll(corner, -1, axis=0)

    @cached_property
    def _area_vectors(self) -> Floats:
        return np.cross(self._sides[0], self._sides[1])
