"""Closed-form Laplace integrals over flat triangles, many points and panels at once.

For a panel with unit outward normal n, corners a_k, altitudes A_k, and its side k (opposite corner
k) with outward in-plane normal m_k, seen from a point x whose foot in the panel's plane is p, and
with r the distances to the corners:

    h    = n · (a − x)                                  height of the plane over x
    t_k  = m_k · (a − x), a on side k                   so that φ_k(p) = t_k / A_k
    f_k  = ln((r_a + r_b + L) / (r_a + r_b − L))        of the side's edge ab of length L
    B_k  = (t_k² + h²) f_k + s_b r_b − s_a r_a          of the edge; s = d · (corner − x)
    Ω    = solid angle, positive for h > 0

    ∫ 1/r dA        = Σ_k t_k f_k − h Ω
    ∫ (y − p)/r dA  = ½ Σ_k m_k B_k
    ∫ φ_i h/r³ dA   = φ_i(p) Ω − h Σ_k (∇φ_i · m_k) f_k

with φ_i the linear function that is 1 at corner i and 0 at the others. t_k² + h² is the squared
distance to the edge's line, so f and B belong to the edge and are computed once for both panels at
it; that both panels see the same f also makes linear functions exact whatever f's rounding.

Sources: Wilton et al. 1984 (IEEE Trans. Antennas Propag. 32) for the single layer; Van Oosterom
and Strackee 1983, eq. 8, for the solid angle.

Arrays have panels along the first axis and points along the last, so that gathering by panel copies
whole rows.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from cageik_cli.mesh import Edges, Floats, Integers

EDGE_ON = 1e-13
"""A panel whose plane passes a point within this (in units of the cage) is seen edge-on: Ω = 0."""

NEAREST = 1e-15
"""Smallest (r_a + r_b − L) / L; below it f is rounding, and so is the distance it multiplies."""


@dataclass(frozen=True, eq=False)
class Panels:
    """Flat triangles that share vertices and edges, with what the integrals need of each.

    Attributes
    ----------
    vertices : (v, 3) float64
        Of a size near one: the tolerances above are absolute.
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
    def edge_spread(self) -> sparse.csr_array:
        """½ m_k along the two axes, (2p, e): from B of the edges to ∫ (y − p) / r dA."""
        count = len(self.corners)
        along = np.einsum("apx,kpx->akp", self.axes, self.side_normals) / 2
        rows = np.arange(2 * count).reshape(2, 1, count)
        rows, columns = np.broadcast_arrays(rows, self.edges.of_side.T)
        return sparse.csr_array(
            (along.ravel(), (rows.ravel(), columns.ravel())),
            shape=(2 * count, len(self.edge_lengths)),
        )

    @cached_property
    def forms(self) -> Floats:
        """Linear forms of (x, 1), (6p + e, 4).

        For every panel h, t_0, t_1, t_2 and the foot's coordinates u, v along `axes` from the
        centroid, then s of every edge's first end, but for its sign the same kind of product.
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


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What the integrals need of panels seen from points: see the module's formulas.

    Attributes
    ----------
    height : (p, q)
        h of each panel's plane over each point.
    side : (3, p, q)
        t_k of each side.
    foot : (2, p, q)
        Coordinates u, v of the foot p along the panel's axes, from its centroid.
    solid_angle : (p, q)
        Ω, steradians in [−2π, 2π].
    edge_log, edge_moment : (e, q)
        f and B of each edge.
    """

    height: Floats
    side: Floats
    foot: Floats
    solid_angle: Floats
    edge_log: Floats
    edge_moment: Floats


def view(panels: Panels, points: Floats) -> View:
    """Look at `panels` from `points`, (q, 3), none of them on an edge."""
    p, edges = len(panels.corners), panels.edges
    forms = panels.forms @ np.vstack([points.T, np.ones(len(points))])
    height, along = forms[:p], forms[6 * p :]
    side, foot = forms[p : 4 * p].reshape(3, p, -1), forms[4 * p : 6 * p].reshape(2, p, -1)
    squares = np.zeros((len(panels.vertices), len(points)))
    for k in range(3):
        squares += (panels.vertices[:, k, None] - points[:, k]) ** 2
    square_a, square_b = squares[edges.ends[:, 0]], squares[edges.ends[:, 1]]
    distance = np.sqrt(squares)
    r_a, r_b = distance[edges.ends[:, 0]], distance[edges.ends[:, 1]]
    length = panels.edge_lengths[:, None]
    around = r_a + r_b
    gap = np.maximum(around - length, NEAREST * length)
    edge_log = np.log((around + length) / gap)
    edge_moment = (square_a - along * along) * edge_log + along * (r_b - r_a) + length * r_b
    products = (square_a + square_b - length * length) / 2
    angle = _solid_angle(panels, height, distance, products)
    return View(height, side, foot, angle, edge_log, edge_moment)


def _solid_angle(panels: Panels, height: Floats, distance: Floats, products: Floats) -> Floats:
    """Ω by Van Oosterom and Strackee, given a · b of each edge's ends seen from the points."""
    r_0, r_1, r_2 = (distance[panels.corners[:, k]] for k in range(3))
    denominator = r_0 * r_1 * r_2
    for k, r in enumerate((r_0, r_1, r_2)):
        denominator += products[panels.edges.of_side[:, k]] * r
    angle = 2 * np.arctan2(2 * panels.areas[:, None] * height, denominator)
    angle[np.abs(height) < EDGE_ON] = 0.0
    return angle


def single_layer_moments(panels: Panels, points: Floats) -> Floats:
    """∫ (1, u, v) / r dA of every panel, (3, p, q) indexed [moment, panel, point].

    u and v run along `axes` from the panel's centroid, so that the moments of a far panel are as
    small as its share of an integral, and sums over panels do not cancel.
    """
    seen = view(panels, points)
    moments = np.empty((3, *seen.height.shape))
    np.multiply(-seen.height, seen.solid_angle, out=moments[0])
    for k in range(3):
        moments[0] += seen.side[k] * seen.edge_log[panels.edges.of_side[:, k]]
    np.multiply(seen.foot, moments[0], out=moments[1:])
    moments[1:] += (panels.edge_spread @ seen.edge_moment).reshape(2, *seen.height.shape)
    return moments


def double_layer(panels: Panels, points: Floats) -> Floats:
    """∫ φ_i h/r³ dA of every panel and corner, (3, p, q) indexed [corner, panel, point].

    The principal value, which is zero, for a point in the panel's own plane.
    """
    seen = view(panels, points)
    integrals = np.asarray(seen.side * (seen.solid_angle / panels.altitudes[:, :, None]))
    for k in range(3):
        scaled = seen.height * seen.edge_log[panels.edges.of_side[:, k]]
        for i in range(3):
            integrals[i] -= panels.slopes[i, k][:, None] * scaled
    return integrals
