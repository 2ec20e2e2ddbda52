"""Flat triangular panels, and closed-form integrals of the Laplace kernels over them.

For a panel with unit outward normal n, corners a_k, altitudes A_k, and its side k (opposite corner
k) with outward in-plane normal m_k, seen from a point x whose foot in the panel's plane is p, and
with r the distances to the corners:

    h    = n · (a − x)                                  height of the plane over x
    t_k  = m_k · (a − x), a on side k                   so that φ_k(p) = t_k / A_k
    f_k  = ln((r_a + r_b + L) / (r_a + r_b − L))        of the side's edge ab of length L
    B_k  = (t_k² + h²) f_k + s_b r_b − s_a r_a          of the edge; s = d · (corner − x)
    Ω    = solid angle, positive for h > 0

    ∫ 1/r dA      = Σ_k t_k f_k − h Ω
    ∫ x/r dA      = x(p) ∫ 1/r dA + ½ Σ_k (∇x · m_k) B_k
    ∫ h/r³ dA     = Ω
    ∫ x h/r³ dA   = x(p) Ω − h Σ_k (∇x · m_k) f_k

where x = φ_0 − ⅓, and y = φ_1 − ⅓ likewise, φ_i being the linear function that is 1 at corner i and
0 at the others. Polynomials are in these coordinates, from the centroid; the monomials x^a y^b have
the order 1, x, y, x², xy, y², x³, ..., and do not depend on the panel's shape. t_k² + h² is the
squared distance to the edge's line, so f and B belong to the edge and are computed once for both
panels at it.

Sources: Wilton et al. 1984 (IEEE Trans. Antennas Propag. 32) for the single layer; Van Oosterom
and Strackee 1983, eq. 8, for the solid angle.

Arrays have panels along the first axis and points along the last, so that gathering by panel copies
whole rows.
"""

from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING

import numpy as np

from cageik_cli.geometry.mesh import Edges
from cageik_cli.util.arrays import Floats, Integers, Workspace

if TYPE_CHECKING:
    from scipy import sparse

EDGE_ON_TOL = 1e-13
"""A point this close to a panel's plane, in cage units, lies in it: Ω = 0."""

MIN_GAP_RATIO = 1e-30
"""Smallest (r_a + r_b − L) / L, which keeps f below 70; f multiplies a tiny distance there."""

NEAR_EDGE_RATIO = 1e-2
"""Below this, (r_a + r_b − L) / L is computed from the distance to the edge's line."""

CLOSED_ANGLE_TOL = 1e-14
"""Solid angles whose sum is 4π within this are not corrected."""

INSIDE_ANGLE_TOL = 1e-3
"""Solid angles whose sum is 4π within this share belong to a point inside."""

MAX_SERIES_TANGENT = 0.03
"""Tangent z below which z − z³/3 + z⁵/5 − z⁷/7 + z⁹/9 is arctan z to the last bit."""

LINEAR_TERMS = 3
"""Number of monomials that are constant or linear."""


@cache
def exponents(order: int) -> tuple[tuple[int, int], ...]:
    """Return (a, b) of the (order + 1)(order + 2)/2 monomials x^a y^b up to degree `order`."""
    return tuple(e for degree in range(order + 1) for e in exponents_at_degree(degree))


def exponents_at_degree(degree: int) -> tuple[tuple[int, int], ...]:
    """Return (a, b) of the monomials of one degree."""
    return tuple((degree - b, b) for b in range(degree + 1))


def monomials(order: int, barycentric: Floats) -> Floats:
    """Return the values of the monomials at `barycentric`, (k, 3), as (d, k)."""
    x, y, _ = barycentric.T - 1 / 3
    return np.stack([x**a * y**b for a, b in exponents(order)])


@cache
def orthogonal_basis(order: int) -> Floats:
    """Return 1, x, y, then polynomials of mean square 1 orthogonal to all before, (d, d).

    Each row holds the coefficients of the monomials. Polynomials after the first three have zero
    mean and first moments, so that their potentials decay with the cube of the distance.
    """
    barycentric, shares = gauss_rule(order + 1)
    values = monomials(order, barycentric)
    orthonormal = np.linalg.inv(np.linalg.cholesky((values * shares) @ values.T))
    orthonormal[:LINEAR_TERMS] = np.eye(LINEAR_TERMS, len(orthonormal))
    return np.asarray(orthonormal)


@cache
def gauss_rule(points: int) -> tuple[Floats, Floats]:
    """Return a product rule of `points` times `points` nodes, exact to degree 2 points − 2.

    The nodes are barycentric coordinates, (points², 3), all inside; their shares of the area,
    (points²,), have the sum 1.
    """
    along, along_shares = np.polynomial.legendre.leggauss(points)
    across, across_shares = _gauss_jacobi(points)
    first = np.repeat((across + 1) / 2, points)
    second = (1 - first) * np.tile((along + 1) / 2, points)
    shares = np.outer(across_shares, along_shares).ravel() / 4
    return np.column_stack([first, second, 1 - first - second]), shares


def _gauss_jacobi(points: int) -> tuple[Floats, Floats]:
    """Return the nodes and weights of Gauss's rule for ∫ (1 − x) f(x) dx over −1 to 1.

    They are eigenvalues of the matrix of the recurrence of Jacobi's polynomials (Golub and Welsch
    1969).
    """
    k = np.arange(points)
    matrix = np.diag(-1.0 / ((2 * k + 1) * (2 * k + 3)))
    beside = np.sqrt(k[1:] * (k[1:] + 1.0)) / (2 * k[1:] + 1)
    nodes, vectors = np.linalg.eigh(matrix + np.diag(beside, 1) + np.diag(beside, -1))
    return nodes, 2 * vectors[0] ** 2


@cache
def edge_coefficients(order: int) -> Floats:
    """Return the monomials of degree below `order` along the sides, (3, d, order).

    On side k, from corner k + 1 at τ = −½ to corner k + 2 at τ = ½, monomial i is
    Σ_j coefficients[k, i, j] τ^j.
    """
    ends = np.eye(3) - 1 / 3
    coefficients = np.zeros((3, len(exponents(order - 1)), order))
    for k in range(3):
        start, stop = ends[(k + 1) % 3], ends[(k + 2) % 3]
        x, y = (np.poly1d([stop[c] - start[c], (stop[c] + start[c]) / 2]) for c in (0, 1))
        for i, (a, b) in enumerate(exponents(order - 1)):
            along = (x**a * y**b).coeffs[::-1]
            coefficients[k, i, : len(along)] = along
    return coefficients


@dataclass(frozen=True, eq=False)
class Panels:
    """Flat triangles that share vertices and edges.

    Vertices, (v, 3), are scaled to a size near one, because the tolerances of the integrals are
    absolute. Corners, (p, 3), are the vertices of each panel, counter-clockwise seen from outside.
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
    def basis_slopes(self) -> Floats:
        """Return ∇φ_k = −m_k / A_k, (3, p, 3)."""
        return np.asarray(-self.side_normals / self.altitudes[:, :, None])

    @cached_property
    def slopes(self) -> Floats:
        """Return ∇φ_i · m_k, (3, 3, p) indexed [i, k]."""
        cosines = np.einsum("ipx,kpx->ikp", self.side_normals, self.side_normals)
        return np.asarray(-cosines / self.altitudes[:, None])

    @cached_property
    def metric(self) -> Floats:
        """Return ∇φ_i · ∇φ_j of the first two basis functions, (2, 2, p)."""
        gradients = self.basis_slopes[:2]
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

        They give h of every panel, then the coordinates x and y of its foot,
        then s of the first end of every edge.
        """
        first, last = self.vertices[self.edges.ends].swapaxes(0, 1)
        tangents = (last - first) / self.edge_lengths[:, None]
        corner = self.vertices[self.corners].swapaxes(0, 1)
        anchored = [
            (self.normals, corner[0]),
            *((-gradient, self.centroids) for gradient in self.basis_slopes[:2]),
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


class PanelView:
    """Geometry of p panels with e edges relative to q points, and the integrals over the panels.

    The arrays are in workspace memory: valid until the next view with the same workspace.

    Parameters
    ----------
    points : (q, 3) float64

    Attributes
    ----------
    height : (p, q)
        Height h of each panel's plane over each point.
    foot : (2, p, q)
        Coordinates x, y of the foot p.
    solid_angle : (p, q)
        Ω, steradians in [−2π, 2π]. It is positive when the point lies behind the outward normal, so
        that the angles of a closed surface sum to 4π inside and to 0 outside.
    along, edge_log, edge_moment : (e, q)
        s of the first end, f and B of each edge.
    distance : (v, q)
        Distance r of each vertex.
    """

    def __init__(self, panels: Panels, points: Floats, workspace: Workspace) -> None:
        self.panels, self.workspace = panels, workspace
        p, q = len(panels.corners), len(points)
        forms = workspace.array("forms", len(panels.linear_forms), q)
        np.matmul(panels.linear_forms, np.vstack([points.T, np.ones(q)]), out=forms)
        self.height, self.along = forms[:p], forms[3 * p :]
        self.foot = forms[p : 3 * p].reshape(2, p, q)
        self.distance = distances(panels.vertices, points, workspace, "distance")
        gap, total, products = self._measure_edge_gaps()
        self._recompute_small_gaps(gap, products)
        length = panels.edge_lengths[:, None]
        np.maximum(gap, MIN_GAP_RATIO * length, out=gap)
        total += length
        total /= gap
        self.edge_log = np.log(total, out=total)
        self.edge_moment = self._compute_edge_moments()
        self.solid_angle = self._compute_solid_angles(products)

    def close_solid_angles(self) -> None:
        """Correct the solid angles of a closed surface so that they sum to 4π for points inside.

        At a distance δ from an edge the angles of its panels are ill-conditioned, with an error of
        rounding over δ; their sum is not. The missing angle is added to the largest one, whose
        panel is near and so has the smallest h: constants and linear functions stay exact. Points
        whose angles do not sum to about 4π are not inside, and are not changed.
        """
        angle = self.solid_angle
        missing = 4 * np.pi - angle.sum(axis=0)
        wrong = np.flatnonzero(
            (np.abs(missing) > CLOSED_ANGLE_TOL) & (np.abs(missing) < 4 * np.pi * INSIDE_ANGLE_TOL)
        )
        angle[np.abs(angle[:, wrong]).argmax(axis=0), wrong] += missing[wrong]

    def set_principal_values(self) -> None:
        """Set Ω = 0 for points in a panel's plane: the principal value for those in the surface."""
        self.solid_angle[np.abs(self.height) < EDGE_ON_TOL] = 0.0

    def linear_moments(self) -> Floats:
        """Return ∫ (1, x, y) / r dA, (3, p, q) indexed [moment, panel, point], in the workspace.

        x and y are relative to the panel's centroid, so that the moments of a distant panel are as
        small as its share of an integral, and sums over panels do not cancel.
        """
        shape = self.height.shape
        moments = self.workspace.array("moments", 3, *shape)
        product = self.workspace.array("product", *shape)
        # Σ_k t_k f_k with t_k = A_k φ_k(p) in powers of the foot's x and y
        logs = (self.panels.altitude_sums @ self.edge_log).reshape(3, *shape)
        total = np.multiply(self.height, self.solid_angle, out=moments[0])
        np.subtract(logs[0], total, out=total)
        for i in (0, 1):
            total += np.multiply(self.foot[i], logs[1 + i], out=product)
        np.multiply(self.foot, total, out=moments[1:])
        moments[1:] += (self.panels.half_slope_sums @ self.edge_moment).reshape(2, *shape)
        return moments

    def double_layer(self) -> Floats:
        """Return ∫ (1, x, y) h/r³ dA, (3, p, q), ordered as `linear_moments`, in the workspace."""
        shape = self.height.shape
        integrals = self.workspace.array("integrals", 3, *shape)
        logs = (self.panels.half_slope_sums @ self.edge_log).reshape(2, *shape)
        logs *= 2
        logs *= self.height
        integrals[0] = self.solid_angle
        np.multiply(self.foot, self.solid_angle, out=integrals[1:])
        integrals[1:] -= logs
        return integrals

    def _measure_edge_gaps(self) -> tuple[Floats, Floats, Floats]:
        """Return r_a + r_b − L, r_a + r_b and 2 (a − x) · (b − x) of every edge ab, (e, q) each."""
        workspace, length = self.workspace, self.panels.edge_lengths[:, None]
        r_a = workspace.take_rows("r_a", self.distance, self.panels.edges.ends[:, 0])
        r_b = workspace.take_rows("r_b", self.distance, self.panels.edges.ends[:, 1])
        total = np.add(r_a, r_b, out=workspace.array("total", *r_a.shape))
        gap = np.subtract(total, length, out=workspace.array("gap", *r_a.shape))
        # 2 a · b = r_a² + r_b² − L² = (r_a + r_b)² − L² − 2 r_a r_b
        products = np.add(total, length, out=workspace.array("products", *r_a.shape))
        products *= gap
        double = np.multiply(r_a, r_b, out=workspace.array("moment", *r_a.shape))
        double *= 2
        products -= double
        return gap, total, products

    def _recompute_small_gaps(self, gap: Floats, products: Floats) -> None:
        """Recompute gaps that lose digits near edges, from the distance δ to the edges' lines.

        r_a r_b + a · b = L² δ² / (r_a r_b − a · b) replaces differences of nearly equal numbers by
        δ² = t² + h².
        """
        panels = self.panels
        limits = NEAR_EDGE_RATIO * panels.edge_lengths
        rows = np.flatnonzero(gap.min(axis=1) < limits)
        row, point = np.nonzero(gap[rows] < limits[rows, None])
        edge = rows[row]
        panel, k = np.divmod(panels.edges.first_side[edge], 3)
        x, y = self.foot[:, panel, point]
        side = panels.altitudes[k, panel] * (np.choose(k, (x, y, -x - y)) + 1 / 3)
        square = side**2 + self.height[panel, point] ** 2
        length, dot = panels.edge_lengths[edge], products[edge, point] / 2
        total = gap[edge, point] + length
        product = (total * total - length * length) / 2 - dot
        beside = dot < 0
        exact = 2 * length[beside] ** 2 * square[beside]
        exact /= (product[beside] - dot[beside]) * (total[beside] + length[beside])
        gap[edge[beside], point[beside]] = exact

    def _compute_edge_moments(self) -> Floats:
        """Return B = (r_a² − s²) f + s (r_b − r_a) + L r_b of every edge, (e, q).

        s is that of the first end a; that of b is s + L. The r_a and r_b that `_measure_edge_gaps`
        has left in the workspace are overwritten.
        """
        workspace, shape = self.workspace, self.along.shape
        r_a, r_b = (workspace.array(name, *shape) for name in ("r_a", "r_b"))
        moment = np.multiply(r_a, r_a, out=workspace.array("moment", *shape))
        moment -= np.multiply(self.along, self.along, out=workspace.array("gap", *shape))
        moment *= self.edge_log
        np.subtract(r_b, r_a, out=r_a)
        r_a *= self.along
        moment += r_a
        r_b *= self.panels.edge_lengths[:, None]
        moment += r_b
        return moment

    def _compute_solid_angles(self, products: Floats) -> Floats:
        """Return Ω, (p, q), by Van Oosterom and Strackee, given 2 a · b of all edges, (e, q)."""
        panels, workspace, shape = self.panels, self.workspace, self.height.shape
        corner = [
            workspace.take_rows(f"r_{k}", self.distance, panels.corners[:, k]) for k in range(3)
        ]
        denominator = workspace.array("denominator", *shape)
        np.multiply(corner[0], corner[1], out=denominator)
        denominator *= corner[2]
        denominator *= 2
        for k in range(3):
            corner[k] *= workspace.take_rows("gathered", products, panels.edges.side_edges[:, k])
            denominator += corner[k]
        numerator = workspace.array("numerator", *shape)
        np.multiply(self.height, 4 * panels.areas[:, None], out=numerator)
        angle = _arctan2(numerator, denominator, workspace)
        angle *= 2
        return angle


def distances(places: Floats, points: Floats, workspace: Workspace, name: str) -> Floats:
    """Return distances of `places`, (v, 3), from points, as (v, q), in workspace array `name`."""
    distance = workspace.array(name, len(places), len(points))
    offset = workspace.array("offset", *distance.shape)
    distance[:] = 0
    for k in range(3):
        np.subtract(places[:, k, None], points[:, k], out=offset)
        offset *= offset
        distance += offset
    return np.sqrt(distance, out=distance)


def _arctan2(y: Floats, x: Floats, workspace: Workspace) -> Floats:
    """Return arctan2(y, x), fast when most angles are small, as those of distant panels are.

    Small angles are summed as a series, several times faster than the library's function where
    that is not vectorised.
    """
    with np.errstate(all="ignore"):  # a quotient that is not finite is not small
        tangent = np.divide(y, x, out=workspace.array("tangent", *x.shape))
        square = np.multiply(tangent, tangent, out=workspace.array("square", *x.shape))
        angle = np.multiply(square, 1 / 9, out=workspace.array("angle", *x.shape))
        for term in (-1 / 7, 1 / 5, -1 / 3):
            angle += term
            angle *= square
        angle += 1
        angle *= tangent
    large = np.flatnonzero(~((square < MAX_SERIES_TANGENT**2) & (x > 0)))
    angle.reshape(-1)[large] = np.arctan2(y.reshape(-1)[large], x.reshape(-1)[large])
    return angle
