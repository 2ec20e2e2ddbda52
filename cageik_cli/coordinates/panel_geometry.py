"""Flat triangular panels and what closed-form integrals over them need, computed once.

Side k of a panel lies opposite its corner k; m_k is its outward normal in the panel's plane, A_k
the corner's altitude over it, n the panel's unit normal. Coordinates u, v run along two axes in the
plane from the centroid.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from cageik_cli.mesh import Edges, Floats, Integers


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
        return Edges.of(self.corners)

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
    def axes(self) -> Floats:
        """Orthonormal axes of each panel's plane, (2, p, 3); the first along its side 0."""
        normal = self.side_normals[0]
        return np.stack([np.cross(self.normals, normal), normal])

    @cached_property
    def gradients(self) -> Floats:
        """∇φ_i = −m_i / A_i along the two axes, (3, 2, p)."""
        along = np.einsum("ipx,apx->iap", self.side_normals, self.axes)
        return np.asarray(-along / self.altitudes[:, None])

    @cached_property
    def hats(self) -> Floats:
        """φ_i = ⅓ + ∇φ_i · (u, v) as coefficients of (1, u, v), (3, 3, p) indexed [i, term]."""
        third = np.full((3, 1, len(self.corners)), 1 / 3)
        return np.concatenate([third, self.gradients], axis=1)

    @cached_property
    def half_normals(self) -> Floats:
        """½ m_k along the two axes, (2, 3, p): from B of the edges to ∫ (y − p) / r dA."""
        return np.asarray(np.einsum("apx,kpx->akp", self.axes, self.side_normals) / 2)

    @cached_property
    def corner_sums(self) -> sparse.csr_array:
        """The matrix (v, 3p) that sums over corners, ordered [corner, panel], at each vertex."""
        corners = self.corners.T.ravel()
        where = (corners, np.arange(len(corners)))
        shape = (len(self.vertices), len(corners))
        return sparse.csr_array((np.ones(len(corners)), where), shape=shape)

    @cached_property
    def forms(self) -> Floats:
        """Linear forms of (x, 1), (6p + e, 4).

        For every panel h, t_0, t_1, t_2 and the foot's coordinates u, v along `axes` from the
        centroid, then s of every edge's first end.
        """
        first, last = self.vertices[self.edges.ends].swapaxes(0, 1)
        tangents = (last - first) / self.edge_lengths[:, None]
        corner = self.vertices[self.corners].swapaxes(0, 1)
        centroid = corner.mean(axis=0)
        anchored = [
            (self.normals, corner[0]),
            *((self.side_normals[k], corner[(k + 1) % 3]) for k in range(3)),
            *((-axis, centroid) for axis in self.axes),
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
