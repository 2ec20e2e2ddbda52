"""The panels of a cage, the order of the density on each, and the basis functions there."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights.bem.higher_terms import HigherTerms
from cageik_cli.method.weights.bem.panels import LINEAR_TERMS, Panels, exponents, orthogonal_basis
from cageik_cli.util.arrays import Floats, Integers, Mask

if TYPE_CHECKING:
    from scipy import sparse


@dataclass(frozen=True, slots=True, eq=False)
class BasisFunctions:
    """Values of the basis functions of n cage vertices at v points of the cage's surface.

    Each point is in a face of the cage, so that at most three basis functions are above 0 there.

    Attributes
    ----------
    corners : (v, 3) int64
        Vertices of a face of the cage that the point is in, in any order.
    values : (v, 3) float64
        Their basis functions at the point, which sum to 1; the others are 0.
    count : int
        n.
    """

    corners: Integers
    values: Floats
    count: int

    @staticmethod
    def at_vertices(count: int) -> "BasisFunctions":
        """Return the basis functions at the vertices of the cage."""
        values = np.zeros((count, 3))
        values[:, 0] = 1
        return BasisFunctions(np.repeat(np.arange(count)[:, None], 3, axis=1), values, count)

    def add_middles(self, ends: Integers) -> "BasisFunctions":
        """Return those at all points, and then in the middle of each pair of `ends`, (e, 2)."""
        corners = self.corners[ends].reshape(len(ends), 6)
        values = self.values[ends].reshape(corners.shape) / 2
        order = np.argsort(corners, axis=1, kind="stable")
        corners = np.take_along_axis(corners, order, axis=1)
        values = np.take_along_axis(values, order, axis=1)
        # Each basis function takes the values of those before it of the same corner, and leaves
        # them nothing.
        for k in range(1, 6):
            is_same = corners[:, k] == corners[:, k - 1]
            values[:, k] += np.where(is_same, values[:, k - 1], 0)
            values[:, k - 1] = np.where(is_same, 0, values[:, k - 1])
        kept = np.sort(np.argsort(values == 0, axis=1, kind="stable")[:, :3], axis=1)
        return BasisFunctions(
            np.concatenate([self.corners, np.take_along_axis(corners, kept, axis=1)]),
            np.concatenate([self.values, np.take_along_axis(values, kept, axis=1)]),
            self.count,
        )

    def evaluate(self, corners: Integers, barycentric: Floats) -> Floats:
        """Return the basis functions, (..., n), between three of the points.

        Parameters
        ----------
        corners : (..., 3) int64
            Numbers of points.
        barycentric : (..., 3) float64
        """
        basis_functions = np.zeros((*barycentric.shape[:-1], self.count))
        places = tuple(np.indices(basis_functions.shape[:-1])[..., None])
        for k in range(3):
            values = barycentric[..., k, None] * self.values[corners[..., k]]
            # A point's corners may be equal where their values are 0.
            np.add.at(basis_functions, (*places, self.corners[corners[..., k]]), values)
        return basis_functions

    def to_matrix(self) -> "sparse.csr_array":
        """Return the values as a sparse matrix, (v, n)."""
        from scipy import sparse

        rows = np.repeat(np.arange(len(self.corners)), 3)
        used = self.values.ravel() != 0
        entries = (self.values.ravel()[used], (rows[used], self.corners.ravel()[used]))
        return sparse.csr_array(entries, shape=(len(self.corners), self.count))


@dataclass(frozen=True, eq=False)
class BoundaryMesh:
    """Panels with polynomial densities: of degrees up to `order` on some, linear on the others.

    The unknowns are coefficients of `panels.orthogonal_basis`: first 1, x and y of every
    panel, ordered [term, panel], then the other terms of `high_panels`, ordered likewise. Those
    above the degree of their panel are zero.

    Attributes
    ----------
    basis_functions : BasisFunctions
        Those of the cage's n vertices, at the vertices of the panels.
    high_panels : (k,) int64
        Numbers of the panels of a degree above 1, ascending.
    degrees : (k,) int64
        Their degrees, from 2 to `order`.
    reach : (k,) float64
        Distance from their centroids at which terms beyond linear have half their strength.
    """

    panels: Panels
    basis_functions: BasisFunctions
    order: int
    high_panels: Integers
    degrees: Integers
    reach: Floats

    @staticmethod
    def from_cage(cage: TriMesh) -> "BoundaryMesh":
        """Build one panel per face, with linear densities."""
        basis_functions = BasisFunctions.at_vertices(len(cage.vertices))
        return _make_linear_mesh(Panels(cage.vertices, cage.faces), basis_functions)

    @property
    def extra_terms(self) -> int:
        """Return the number of unknowns beyond linear of a panel of higher order."""
        return len(exponents(self.order)) - LINEAR_TERMS

    @property
    def linear_unknowns(self) -> int:
        """Return the number of unknowns of linear terms, which come first."""
        return LINEAR_TERMS * len(self.panels.corners)

    @property
    def unknowns(self) -> int:
        """Return the number of unknowns, u."""
        return self.linear_unknowns + self.extra_terms * len(self.high_panels)

    @cached_property
    def double_layer_to_basis(self) -> "sparse.csr_array":
        """Return the map from ∫ (1, x, y) h/r³, [term, panel], to D of each φ_k, (n, 3p)."""
        from scipy import sparse

        starts, rows, values = self.double_layer_columns
        shape = (self.basis_functions.count, len(starts) - 1)
        return sparse.csr_array(sparse.csc_array((values, rows, starts), shape=shape))

    @cached_property
    def double_layer_columns(self) -> tuple[NDArray[np.int32], NDArray[np.int32], Floats]:
        """Return the starts, rows and values of the columns of `double_layer_to_basis`.

        A row may come more than once in a column: its values are added.
        """
        rows = self.basis_functions.corners[self.panels.corners].reshape(
            len(self.panels.corners), -1
        )
        at_corners = self.basis_functions.values[self.panels.corners]
        # φ_0 = ⅓ + x, φ_1 = ⅓ + y, φ_2 = ⅓ − x − y
        factors = np.array([[1 / 3, 1 / 3, 1 / 3], [1, 0, -1], [0, 1, -1]])
        values = (factors[:, None, :, None] * at_corners).reshape(-1, rows.shape[1])
        used = values != 0
        starts = np.concatenate([[0], np.cumsum(used.sum(axis=1))])
        rows = np.tile(rows, (len(factors), 1))[used]
        return starts.astype(np.int32), rows.astype(np.int32), values[used]

    @cached_property
    def higher_terms(self) -> HigherTerms:
        """Return the terms beyond linear, for their integrals."""
        return HigherTerms(self.panels, self.high_panels, self.order)

    @cached_property
    def higher_arrays(self) -> tuple[Floats | Integers, ...]:
        """Return what the compiled core needs of the terms beyond linear, in its order."""
        arrays = (
            self.high_panels,
            self.panels.centroids[self.high_panels],
            self.reach,
            self.higher_terms.side_factors,
            self.panels.metric,
            orthogonal_basis(self.order)[LINEAR_TERMS:],
        )
        return tuple(map(np.ascontiguousarray, arrays))

    @cached_property
    def panel_degrees(self) -> Integers:
        """Return the degree of the densities on each panel, (p,)."""
        highest = np.ones(len(self.panels.corners), np.int64)
        highest[self.high_panels] = self.degrees
        return highest

    @cached_property
    def unknown_degrees(self) -> tuple[Integers, Integers, Integers]:
        """Return of each unknown, (u,): its degree, the highest degree on its panel, its panel."""
        panels = np.arange(len(self.panels.corners))
        degree = np.array([a + b for a, b in exponents(self.order)])
        panel = np.concatenate(
            [np.tile(panels, LINEAR_TERMS), np.tile(self.high_panels, self.extra_terms)]
        )
        counts = np.repeat([len(panels), len(self.high_panels)], [LINEAR_TERMS, self.extra_terms])
        return np.repeat(degree, counts), self.panel_degrees[panel], panel

    @cached_property
    def solved_unknowns(self) -> Integers:
        """Return the unknowns up to the degree of their panel, ascending; others are zero."""
        degree, highest, _ = self.unknown_degrees
        return np.flatnonzero(degree <= highest)

    @cached_property
    def equation_places(self) -> Integers:
        """Return the place of each unknown, (u,), among those that are solved; −1 for others."""
        places = np.full(self.unknowns, -1)
        places[self.solved_unknowns] = np.arange(len(self.solved_unknowns))
        return places

    def panel_unknowns(self, chosen: Integers) -> Integers:
        """Return the unknowns of some panels, (c, 3), or (c, d) if they are of higher order."""
        linear = np.arange(LINEAR_TERMS) * len(self.panels.corners) + chosen[:, None]
        place = np.searchsorted(self.high_panels, chosen)
        if len(self.high_panels) == 0 or not np.array_equal(
            self.high_panels[place % len(self.high_panels)], chosen
        ):
            return linear
        higher = np.arange(self.extra_terms) * len(self.high_panels) + place[:, None]
        return np.concatenate([linear, self.linear_unknowns + higher], axis=1)

    def raise_order(
        self, high_panels: Integers, degrees: Integers, reach: Floats
    ) -> "BoundaryMesh":
        """Return the mesh with densities of these degrees on `high_panels`, ascending."""
        order = int(degrees.max(initial=1))
        return BoundaryMesh(self.panels, self.basis_functions, order, high_panels, degrees, reach)

    def divide(self, chosen: Mask) -> "BoundaryMesh":
        """Divide each panel of the mask `chosen`, (p,), into four; all densities become linear.

        Children take the place of their parent. A long side may then meet two short ones, which
        costs no accuracy because all integrals are in closed form.
        """
        corners, vertices = self.panels.corners, self.panels.vertices
        sides, place = np.unique(self.panels.edges.side_edges[chosen], return_inverse=True)
        ends = self.panels.edges.ends[sides]
        a, b, c = corners[chosen].T
        opposite_a, opposite_b, opposite_c = (place.reshape(-1, 3) + len(vertices)).T
        children = np.stack(
            [
                np.stack([a, opposite_c, opposite_b], axis=1),
                np.stack([b, opposite_a, opposite_c], axis=1),
                np.stack([c, opposite_b, opposite_a], axis=1),
                np.stack([opposite_a, opposite_b, opposite_c], axis=1),
            ],
            axis=1,
        )
        divided = np.repeat(corners, np.where(chosen, 4, 1), axis=0)
        divided[np.repeat(chosen, np.where(chosen, 4, 1))] = children.reshape(-1, 3)
        middles = vertices[ends].mean(axis=1)
        panels = Panels(np.concatenate([vertices, middles]), divided)
        return _make_linear_mesh(panels, self.basis_functions.add_middles(ends))

    def evaluate_basis_functions(self, chosen: Integers, barycentric: Floats) -> Floats:
        """Return the basis functions, (c, j, n), at `barycentric`, (j, 3), of some panels."""
        shape = (len(chosen), *barycentric.shape)
        corners = np.broadcast_to(self.panels.corners[chosen][:, None], shape)
        return self.basis_functions.evaluate(corners, np.broadcast_to(barycentric, shape))


def _make_linear_mesh(panels: Panels, basis_functions: BasisFunctions) -> BoundaryMesh:
    none = np.empty(0, np.int64)
    return BoundaryMesh(panels, basis_functions, 1, none, none, np.empty(0))
