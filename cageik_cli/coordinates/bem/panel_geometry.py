"""Flat triangular panels, and the geometry that closed-form integrals over them need.

Side k of a panel lies opposite its corner k; m_k is its outward normal in the panel's plane, A_k
the corner's altitude over it, n the panel's unit normal, φ_k the hat of corner k.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from cageik_cli.geometry.mesh import Edges
from cageik_cli.util.arrays import Floats, Integers

if TYPE_CHECKING:
    from scipy import sparse


@dataclass(frozen=True, eq=False)
class Panels:
    """Flat triangles that share vertices and edges.

    Attributes
    ----------
    vertices : (v, 3) float64
        Scaled to a size near one, because the tolerances of the integrals are absolute.
    corners : (p, 3) int64
        Vertices of each panel, counter-clockwise seen from outside.
    """

    vertices: Floats
    corners: Integers

    @cached_property
    def edges(self) -> Edges:
        """Return the edges; side k of a panel is opposite its corner k."""
        return Edges.from_faces(self.corners)

    @cached_property
    def edge_lengths(self) -> Floats:
        """Return the length L of each edge, (e,)."""
        return np.asarray(np.linalg.norm(np.ptp(self.vertices[self.edges.ends], axis=1), axis=1))

    @cached_property
    def normals(self) -> Floats:
        """Return the unit outward normals n, (p, 3)."""
        return np.asarray(self._area_vectors / (2 * self.areas[:, None]))

    @cached_property
    def areas(self) -> Floats:
        """Return the areas, (p,)."""
        return np.asarray(np.linalg.norm(self._area_vectors, axis=1) / 2)

    @cached_property
    def side_normals(self) -> Floats:
        """Return the outward in-plane unit normals m_k of the sides, (3, p, 3)."""
        normals = np.cross(self._sides, self.normals)
        return np.asarray(normals / np.linalg.norm(normals, axis=2, keepdims=True))

    @cached_property
    def altitudes(self) -> Floats:
        """Return the distance A_k of each corner from the opposite side, (3, p)."""
        return np.asarray(2 * self.areas / np.linalg.norm(self._sides, axis=2))

    @cached_property
    def slopes(self) -> Floats:
        """Return ∇φ_i · m_k, (3, 3, p) indexed [i, k]; ∇φ_i = −m_i / A_i."""
        cosines = np.einsum("ipx,kpx->ikp", self.side_normals, self.side_normals)
        return np.asarray(-cosines / self.altitudes[:, None])

    @cached_property
    def metric(self) -> Floats:
        """Return ∇φ_i · ∇φ_j of the first two hats, (2, 2, p)."""
        gradients = -self.side_normals[:2] / self.altitudes[:2, :, None]
        return np.asarray(np.einsum("ipx,jpx->ijp", gradients, gradients))

    @cached_property
    def centroids(self) -> Floats:
        """Return the mean of the corners, (p, 3)."""
        return np.asarray(self.vertices[self.corners].mean(axis=1))

    @cached_property
    def radii(self) -> Floats:
        """Return the distance of the farthest corner from the centroid, (p,)."""
        corner = self.vertices[self.corners]
        return np.asarray(np.linalg.norm(corner - self.centroids[:, None], axis=2).max(axis=1))

    @cached_property
    def edge_signs(self) -> Floats:
        """Return 1 where side k, from corner k + 1, runs along its edge, else −1, (p, 3)."""
        starts = np.roll(self.corners, -1, axis=1)
        return np.where(starts == self.edges.ends[self.edges.side_edges, 0], 1.0, -1.0)

    @cached_property
    def altitude_sums(self) -> "sparse.csr_array":
        """Return the sums over sides of f with factors A_k / 3, A_0 − A_2 and A_1 − A_2, (3p, e).

        Because t_k = A_k φ_k(p), the products of the three with 1, x, y of the foot sum to
        Σ_k t_k f_k.
        """
        zero, (a, b, c) = np.zeros(len(self.corners)), self.altitudes
        return self._build_side_sums(
            np.array([[a / 3, b / 3, c / 3], [a, zero, -c], [zero, b, -c]])
        )

    @cached_property
    def half_slope_sums(self) -> "sparse.csr_array":
        """Return the sums over sides with factors ½ ∇x · m_k and ½ ∇y · m_k, (2p, e)."""
        return self._build_side_sums(self.slopes[:2] / 2)

    def _build_side_sums(self, factors: Floats) -> "sparse.csr_array":
        """Return sums over the sides of panels with `factors`, (sums, 3, p), as (sums p, e)."""
        from scipy import sparse

        count = len(factors) * len(self.corners)
        rows = np.broadcast_to(np.arange(count).reshape(len(factors), 1, -1), factors.shape)
        columns = np.broadcast_to(self.edges.side_edges.T, factors.shape)
        used = factors != 0
        shape = (count, len(self.edges.ends))
        return sparse.csr_array((factors[used], (rows[used], columns[used])), shape=shape)

    @cached_property
    def linear_forms(self) -> Floats:
        """Return linear forms of (x, 1), (3p + e, 4).

        They give h of every panel, then the coordinates x and y of its foot (see `polynomials`),
        then s of the first end of every edge.
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
    def kernel_arrays(self) -> tuple[Floats | Integers, ...]:
        """Return what the compiled core needs of the panels, in its order."""
        arrays = (
            self.vertices,
            self.corners,
            self.edges.ends,
            self.edges.side_edges,
            self.edges.first_side,
            self.edge_lengths,
            self.areas,
            self.altitudes,
            self.slopes[:2] / 2,
            self.linear_forms,
        )
        return tuple(map(np.ascontiguousarray, arrays))

    @cached_property
    def _sides(self) -> Floats:
        corner = self.vertices[self.corners].swapaxes(0, 1)
        return np.roll(corner, -2, axis=0) - np.roll(corner, -1, axis=0)

    @cached_property
    def _area_vectors(self) -> Floats:
        return np.cross(self._sides[0], self._sides[1])
