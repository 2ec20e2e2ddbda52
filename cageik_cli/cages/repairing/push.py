"""Move a cage outward, and no more of it than must be, until it holds points of the model."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import closest_points, winding_numbers
from cageik_cli.util.arrays import Floats, Integers

MAX_ROUNDS = 30
"""How often all vertices are moved, at most."""

SMOOTHNESS = 0.02
"""Weight of differences between the moves of neighbours, against one point's distance."""

STIFFNESS = 0.02
"""Weight of a vertex's own move: what need not move stays."""

MAX_STEP = 1.5
"""How far a vertex moves in one round, at most, over what is missing most."""

MIN_DIRECTION = 1e-9
"""A point nearer to the cage than this, in diagonals of the cage, is pushed along the normal."""


@dataclass(frozen=True, slots=True, eq=False)
class Clearance:
    """How far points must keep from the cage, file units.

    Attributes
    ----------
    least : float or (s,) float64
        Points nearer than this, or outside, are pushed for; each has its own, or all have one,
    target : float
        to this distance.
    """

    least: float | Floats
    target: float


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
        How far the face must move along it, file units.
    """

    corners: Integers
    weights: Floats
    direction: Floats
    missing: Floats


def push_outward(cage: TriMesh, samples: Floats, clearance: Clearance) -> TriMesh:
    """Move the cage until the samples have the clearance, or no more is won.

    Each round is a least-squares problem in all vertices: what is missing along the directions of
    contacts, against the moves themselves and their differences between neighbours.
    """
    form = _move_penalty(cage)
    for _ in range(MAX_ROUNDS):
        contacts = find_contacts(cage, samples, clearance)
        if len(contacts.missing) == 0:
            break
        cage = TriMesh(cage.vertices + _solve_moves(contacts, form), cage.faces)
    return cage


def find_contacts(cage: TriMesh, samples: Floats, clearance: Clearance) -> Contacts:
    """Find the samples that are outside, or nearer to the cage than they may be."""
    inside = winding_numbers(cage, samples) >= 0.5
    closest = closest_points(cage, samples)
    height = np.where(inside, closest.distance, -closest.distance)
    chosen = height < clearance.least
    corners = cage.faces[closest.face[chosen]]
    a, b, c = (cage.vertices[corners[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny)
    away = (closest.position[chosen] - samples[chosen]) * np.sign(height[chosen])[:, None]
    length = np.linalg.norm(away, axis=1, keepdims=True)
    short = length < MIN_DIRECTION * cage.diagonal
    direction = np.where(short, normal, away / np.where(short, 1.0, length))
    weights = _barycentric_weights(closest.position[chosen], np.stack([a, b, c], axis=1))
    return Contacts(corners, weights, direction, clearance.target - height[chosen])


def _barycentric_weights(points: Floats, triangles: Floats) -> Floats:
    """Of points (k, 3) in triangles (k, 3, 3); a third each where there is no area."""
    a, b, c = (triangles[:, k] - points for k in range(3))
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    parts = [np.einsum("kx,kx->k", np.cross(p, q), normal) for p, q in ((b, c), (c, a), (a, b))]
    weights = np.stack(parts, axis=1)
    total = weights.sum(axis=1, keepdims=True)
    return np.where(total > 0, weights / np.where(total > 0, total, 1.0), 1 / 3)


def _solve_moves(contacts: Contacts, form: sparse.csc_array) -> Floats:
    """The move of every vertex, (n, 3)."""
    count, size = len(contacts.missing), form.shape[0]
    rows = np.repeat(np.arange(count), 9)
    columns = 3 * np.repeat(contacts.corners, 3, axis=1) + np.tile(np.arange(3), 3)
    values = contacts.weights[:, :, None] * contacts.direction[:, None]
    to_heights = sparse.csc_array((values.ravel(), (rows, columns.ravel())), shape=(count, size))
    # Deep contacts count for more: where many points are nearly there, one may not be.
    weight = contacts.missing / contacts.missing.max() + 0.1
    normal = to_heights.T @ (to_heights * weight[:, None]) + form
    moves = splu(sparse.csc_matrix(normal)).solve(to_heights.T @ (weight * contacts.missing))
    moves = moves.reshape(-1, 3)
    length = np.linalg.norm(moves, axis=1, keepdims=True)
    longest = MAX_STEP * contacts.missing.max()
    return np.asarray(moves * np.minimum(1, longest / np.maximum(length, longest)))


def _move_penalty(cage: TriMesh) -> sparse.csc_array:
    """The matrix of the quadratic form that keeps moves small and alike, (3n, 3n)."""
    count, ends = len(cage.vertices), cage.edges.ends
    rows = np.repeat(np.arange(len(ends)), 2)
    signs = np.tile([1.0, -1.0], len(ends))
    gradient = sparse.csc_array((signs, (rows, ends.ravel())), shape=(len(ends), count))
    form = SMOOTHNESS * (gradient.T @ gradient) + STIFFNESS * sparse.eye_array(count)
    return sparse.csc_array(sparse.kron(form, sparse.eye_array(3)))
