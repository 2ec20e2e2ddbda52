"""Flat triangular panels, the geometry that closed-form integrals need, and polynomials on them.

Side k of a panel lies opposite its corner k; m_k is its outward normal in the panel's plane, A_k
the corner's altitude over it, n the panel's unit normal, φ_k the basis function of corner k.

Polynomials are in the coordinates x = φ_0 − ⅓ and y = φ_1 − ⅓, from the centroid; the monomials
x^a y^b have the order 1, x, y, x², xy, y², x³, ... They do not depend on the panel's shape.
"""

from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING

import numpy as np

from cageik_cli.geometry.mesh import Edges
from cageik_cli.util.arrays import Floats, Integers

if TYPE_CHECKING:
    from scipy import sparse

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
