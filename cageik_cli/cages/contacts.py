"""Points that are too near to a cage, and the smallest smooth move that gives them room."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers

MAX_STEP = 1.5
"""How far a vertex moves at once, at most, relative to the largest distance that is missing."""

SHALLOW_WEIGHT = 0.1
"""Weight of a contact that misses nothing; the deepest has this and one."""


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """Points that are too near to the cage, or outside.

    Attributes
    ----------
    corners : (k, 3) int64
        The vertices of the nearest face.
    weights : (k, 3) float64
        Barycentric, of the nearest point.
    direction : (k, 3) float64
        Unit, outward.
    missing : (k,) float64
        How far the face must move along it.
    """

    corners: Integers
    weights: Floats
    direction: Floats
    missing: Floats


@dataclass(frozen=True, slots=True)
class MoveCosts:
    """The cost of moves, relative to the distance that one point misses.

    Attributes
    ----------
    smoothness : float
        Of differences between the moves of neighbours.
    stiffness : float
        Of a vertex's own move.
    """

    smoothness: float
    stiffness: float

    def make_form(self, cage: TriMesh) -> sparse.csc_array:
        """Return the matrix of the quadratic form in the moves of all vertices, (3n, 3n)."""
        count, ends = len(cage.vertices), cage.edges.ends
        rows = np.repeat(np.arange(len(ends)), 2)
        signs = np.tile([1.0, -1.0], len(ends))
        gradient = sparse.csc_array((signs, (rows, ends.ravel())), shape=(len(ends), count))
        form = self.smoothness * (gradient.T @ gradient) + self.stiffness * sparse.eye_array(count)
        return sparse.csc_array(sparse.kron(form, sparse.eye_array(3)))


def solve_moves(contacts: Contacts, form: sparse.csc_array) -> Floats:
    """Solve for the move of every vertex, (n, 3): least squares of what is missing, and `form`."""
    count, size = len(contacts.missing), form.shape[0]
    rows = np.repeat(np.arange(count), 9)
    columns = 3 * np.repeat(contacts.corners, 3, axis=1) + np.tile(np.arange(3), 3)
    values = contacts.weights[:, :, None] * contacts.direction[:, None]
    to_heights = sparse.csc_array((values.ravel(), (rows, columns.ravel())), shape=(count, size))
    # Deep contacts count for more: where many points are nearly there, one may not be.
    weight = contacts.missing / contacts.missing.max() + SHALLOW_WEIGHT
    normal = to_heights.T @ (to_heights * weight[:, None]) + form
    moves = splu(sparse.csc_matrix(normal)).solve(to_heights.T @ (weight * contacts.missing))
    moves = moves.reshape(-1, 3)
    length = np.linalg.norm(moves, axis=1, keepdims=True)
    longest = MAX_STEP * contacts.missing.max()
    return np.asarray(moves * np.minimum(1, longest / np.maximum(length, longest)))
