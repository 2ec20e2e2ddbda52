"""Push a cage off points that are too near to it, by the smallest smooth moves that do so."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers

MAX_PUSHES = 30
"""How often all vertices are moved, at most."""

MAX_FRUITLESS_PUSHES = 6
"""Pushes end when what is missing most has not shrunk by a tenth in this many of them."""

MAX_PUSH_STEP = 1.5
"""How far a vertex moves at once, in the largest distance that is missing."""


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


def push(
    cage: TriMesh,
    find_contacts: Callable[[TriMesh, float], Contacts | None],
    *,
    smoothness: float,
    stiffness: float,
    enough: float = 0.0,
) -> TriMesh:
    """Move the cage until nothing is missing, or pushes stop helping.

    Each push is a least-squares problem in all vertices: what is missing along the directions of
    contacts, against the moves themselves and their differences between neighbours.

    Parameters
    ----------
    find_contacts : callable
        Of the cage, and of how far its vertices moved at most since the last call; None if no
        point is too near.
    smoothness, stiffness : float
        The cost of differences between the moves of neighbours, and of moves, relative to that of
        the distance that one point misses.
    enough : float
        Pushes end when no contact misses more, file units; or what is missing most does not shrink.
    """
    form = make_form(cage, smoothness, stiffness)
    longest, deepest = 0.0, [np.inf] * MAX_FRUITLESS_PUSHES
    for _ in range(MAX_PUSHES):
        contacts = find_contacts(cage, longest)
        if contacts is None or len(contacts.missing) == 0 or contacts.missing.max() < enough:
            break
        deepest.append(float(contacts.missing.max()))
        if deepest[-1] > 0.9 * deepest[-1 - MAX_FRUITLESS_PUSHES]:
            break
        # Deep contacts count for more: where many points are nearly there, one may not be.
        moves = solve_moves(contacts, contacts.missing / deepest[-1] + 0.1, form)
        lengths = np.linalg.norm(moves, axis=1, keepdims=True)
        most = MAX_PUSH_STEP * deepest[-1]
        moves *= np.minimum(1, most / np.maximum(lengths, most))
        longest = float(np.linalg.norm(moves, axis=1).max())
        cage = TriMesh(cage.vertices + moves, cage.faces)
    return cage


def make_form(cage: TriMesh, smoothness: float, stiffness: float) -> sparse.csc_array:
    """Return the matrix of the quadratic form in the moves of all vertices, (3n, 3n)."""
    count, ends = len(cage.vertices), cage.edges.ends
    rows = np.repeat(np.arange(len(ends)), 2)
    signs = np.tile([1.0, -1.0], len(ends))
    gradient = sparse.csc_array((signs, (rows, ends.ravel())), shape=(len(ends), count))
    form = smoothness * (gradient.T @ gradient) + stiffness * sparse.eye_array(count)
    return sparse.csc_array(sparse.kron(form, sparse.eye_array(3)))


def solve_moves(contacts: Contacts, weight: Floats, form: sparse.csc_array) -> Floats:
    """Solve for the move of every vertex, (n, 3): least squares of what is missing, and `form`.

    Parameters
    ----------
    weight : (k,)
        Of each contact.
    """
    count, size = len(contacts.missing), form.shape[0]
    rows = np.repeat(np.arange(count), 9)
    columns = 3 * np.repeat(contacts.corners, 3, axis=1) + np.tile(np.arange(3), 3)
    values = contacts.weights[:, :, None] * contacts.direction[:, None]
    to_heights = sparse.csc_array((values.ravel(), (rows, columns.ravel())), shape=(count, size))
    normal = to_heights.T @ (to_heights * weight[:, None]) + form
    moves = splu(sparse.csc_matrix(normal)).solve(to_heights.T @ (weight * contacts.missing))
    return np.asarray(moves.reshape(-1, 3))


def move_to_neighbours(cage: TriMesh, chosen: Integers, step: float) -> Floats:
    """Return the vertices (n, 3), the chosen ones moved towards the mean of their neighbours.

    Parameters
    ----------
    chosen : (k,) int64
        Numbers of vertices.
    step : float
        The share of the way to the mean.
    """
    ends = cage.edges.ends
    both = np.concatenate([ends, ends[:, ::-1]])
    both = both[np.isin(both[:, 0], chosen)]
    count = np.bincount(both[:, 0], minlength=len(cage.vertices))
    total = np.zeros_like(cage.vertices)
    np.add.at(total, both[:, 0], cage.vertices[both[:, 1]])
    vertices = cage.vertices.copy()
    mean = total[chosen] / np.maximum(count[chosen], 1)[:, None]
    vertices[chosen] += step * (mean - vertices[chosen])
    return vertices
