"""Put vertices that are hidden where the surface around them has them, as rigidly as possible.

With the rest pose p, the positions x of the vertices that are seen, and a rotation R_i per vertex,

    minimise  Σ_ij |x_i − x_j − R_i (p_i − p_j)|²  over the hidden x and all R,

in turn (Sorkine and Alexa 2007, with the weight 1 per edge). A cage that is solved without a piece
follows the rest so closely that there it may be anywhere; a surface bends, and does not stretch.

What a cage cannot follow around a piece goes on into it. Residuals r of what is seen are continued
so that Σ_i |Σ_j (r_i − r_j)|² / d_i is least, with the d_i neighbours j of i.
"""

from typing import Any

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.rotations import nearest_rotations_by_entry
from cageik_cli.util.arrays import Floats, Integers, Mask

RIGID_ROUNDS = 20
"""Rounds of rotations and positions: with 60, the error is up to a tenth less."""

HOLD_WEIGHT = 1e-9
"""Weight by which vertices stay where they begin: a part of which nothing is seen has no other."""


class RigidFiller:
    """Filler of frames of a mesh; the factors of the last hidden vertices are kept."""

    def __init__(self, mesh: TriMesh) -> None:
        ends = mesh.edges.ends
        both = np.concatenate([ends, ends[:, ::-1]])
        self._pairs = both[np.argsort(both[:, 0], kind="stable")]
        self._rest, self._is_hidden = mesh.vertices, np.zeros(len(mesh.vertices), bool)
        self._factor: Any = None
        self._bending = _make_bending(ends, len(mesh.vertices))

    def extend(self, values: Floats, is_hidden: Mask) -> Floats:
        """Return values (m, 3) whose hidden ones, (m,), continue the others; they may be any."""
        if not (is_hidden == self._is_hidden).all():
            self._prepare(is_hidden)
        extended = values.copy()
        if self._factor is not None:
            extended[is_hidden] = self._bend_factor.solve(-self._across @ values[~is_hidden])
        return extended

    def fill(self, positions: Floats, is_hidden: Mask) -> Floats:
        """Return positions (m, 3) whose hidden ones, (m,), are moved; they are the first guess."""
        if not (is_hidden == self._is_hidden).all():
            self._prepare(is_hidden)
        filled = positions.copy()
        if self._factor is None:
            return filled
        joined, second = self._joined, self._edges[:, 1]
        for _ in range(RIGID_ROUNDS):
            rotations = self._find_rotations(filled)
            means = (rotations[self._first_ring] + rotations[self._second_ring]) / 2
            pulls = np.einsum("eab,eb->ea", means, self._sides)
            # What is seen is known: it goes to the other side.
            pulls += np.where(is_hidden[second, None], 0.0, filled[second])
            right = HOLD_WEIGHT * filled[joined]
            right += np.add.reduceat(pulls, self._starts)
            filled[joined] = self._factor.solve(right)
        return filled

    def _find_rotations(self, positions: Floats) -> Floats:
        """Return the rotation of the rest pose to the positions around each vertex of the ring."""
        first, second = self._ring_edges.T
        sides = positions[first] - positions[second]
        products = (sides[:, :, None] * self._ring_sides[:, None, :]).reshape(-1, 9)
        sums = np.add.reduceat(products, self._ring_starts)
        return nearest_rotations_by_entry(np.ascontiguousarray(sums.T)).T.reshape(-1, 3, 3)

    def _prepare(self, is_hidden: Mask) -> None:
        """List the edges at hidden vertices and those at their neighbours, and factor."""
        from scipy import sparse
        from scipy.sparse.linalg import splu

        self._is_hidden, self._factor = is_hidden.copy(), None
        pairs, rest = self._pairs, self._rest
        self._edges = pairs[is_hidden[pairs[:, 0]]]
        if not len(self._edges):
            return
        is_ring = np.zeros(len(rest), bool)
        is_ring[self._edges] = True
        self._ring_edges = pairs[is_ring[pairs[:, 0]]]
        ring, self._ring_starts = np.unique(self._ring_edges[:, 0], return_index=True)
        self._first_ring, self._second_ring = np.searchsorted(ring, self._edges).T
        self._ring_sides = rest[self._ring_edges[:, 0]] - rest[self._ring_edges[:, 1]]
        self._sides = rest[self._edges[:, 0]] - rest[self._edges[:, 1]]
        self._joined, self._starts = np.unique(self._edges[:, 0], return_index=True)
        count = len(self._joined)
        degrees = np.diff(self._starts, append=len(self._edges))
        inner = np.searchsorted(self._joined, self._edges[is_hidden[self._edges[:, 1]]])
        places = np.arange(count)
        entries = np.concatenate([degrees + HOLD_WEIGHT, -np.ones(len(inner))])
        rows, columns = (np.concatenate([places, side]) for side in inner.T)
        matrix = sparse.coo_array((entries, (rows, columns)), shape=(count, count))
        self._factor = splu(matrix.tocsc())
        rows = self._bending[is_hidden]
        held = HOLD_WEIGHT * sparse.eye_array(rows.shape[0])
        self._bend_factor = splu((rows[:, is_hidden] + held).tocsc())
        self._across = rows[:, ~is_hidden]


def _make_bending(ends: Integers, count: int) -> Any:
    """Return the matrix of Σ_i |Σ_j (r_i − r_j)|² / d_i, sparse (m, m), for edges (e, 2)."""
    from scipy import sparse

    first, second = np.concatenate([ends, ends[:, ::-1]]).T
    joined = sparse.coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    degrees = np.bincount(first, minlength=count).astype(float)
    laplacian = sparse.diags_array(degrees) - joined
    means = sparse.diags_array(1 / np.maximum(degrees, 1))
    return (laplacian @ means @ laplacian).tocsr()
