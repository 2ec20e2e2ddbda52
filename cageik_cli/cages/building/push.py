"""Move a cage outward until points of the model have their clearance, and untangle it."""

from dataclasses import dataclass

import igl
import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from cageik_cli.geometry.intersections import self_intersections
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import winding_numbers
from cageik_cli.util.arrays import Floats, Integers

ROUNDS = 30
"""Pushes, at most."""

PATIENCE = 6
"""Pushes in which what is missing most must become less, or they end."""

MOST_TANGLED = 60
"""Pairs of faces that cross, above which a cage is not worth untangling."""

SMOOTHNESS = 0.05
"""Weight of differences between the moves of neighbours, against one point's distance."""

STIFFNESS = 0.005
"""Weight of a vertex's own move."""

LONGEST_STEP = 1.5
"""How far a vertex moves in one push, at most, over what is missing most."""

MARGIN = 1.03
"""Pushes aim at this many clearances, so that they come to an end,"""

REACHED = 1.015
"""which is with this many."""


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


def push_outward(cage: TriMesh, samples: Floats, clearance: float) -> TriMesh:
    """Move the cage until the samples have the clearance, or no more is won.

    Every push is a least-squares problem in all vertices: what is missing along the directions of
    contacts, neighbours moving alike.
    """
    smooth = _smoothness(cage)
    vertices = cage.vertices
    history: list[float] = []
    for _ in range(ROUNDS):
        contacts = find_contacts(TriMesh(vertices, cage.faces), samples, MARGIN * clearance)
        if len(contacts.missing) == 0 or contacts.missing.max() < (MARGIN - REACHED) * clearance:
            break
        history.append(float(contacts.missing.max()))
        if len(history) > PATIENCE and history[-1] > 0.9 * history[-1 - PATIENCE]:
            break
        vertices = vertices + _step(contacts, smooth)
    return TriMesh(vertices, cage.faces)


def find_contacts(cage: TriMesh, samples: Floats, clearance: float) -> Contacts:
    """The samples with less than the clearance."""
    signed, face, nearest, normal = igl.signed_distance(
        samples, cage.vertices, cage.faces, igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
    )
    # libigl counts the inside negative. Where a cage crosses itself its normals mislead.
    doubtful = np.flatnonzero(signed > 0)
    if len(doubtful):
        inside = winding_numbers(cage, samples[doubtful]) > 0.5
        signed[doubtful[inside]] *= -1
    close = np.flatnonzero(signed > -clearance)
    corners = cage.faces[face[close]]
    a, b, c = (cage.vertices[corners[:, k]] for k in range(3))
    weights = igl.barycentric_coordinates(nearest[close].copy(), a, b, c).reshape(-1, 3)
    direction = (samples[close] - nearest[close]) * np.sign(signed[close])[:, None]
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    direction = np.where(length > 1e-9, direction / np.maximum(length, 1e-9), normal[close])
    return Contacts(corners, weights, direction, signed[close] + clearance)


def _step(contacts: Contacts, smooth: sparse.csc_array) -> Floats:
    """The move of every vertex, (n, 3)."""
    count = len(contacts.missing)
    rows = np.repeat(np.arange(count), 9)
    columns = 3 * np.repeat(contacts.corners, 3, axis=1) + np.tile(np.arange(3), 3)
    values = (contacts.weights[:, :, None] * contacts.direction[:, None]).reshape(count, 9)
    size = smooth.shape[0]
    map_ = sparse.csc_array((values.ravel(), (rows, columns.ravel())), shape=(count, size))
    # Deep contacts count for more: where many points are nearly there, one may not be.
    weight = contacts.missing / contacts.missing.max() + 0.1
    normal = map_.T @ (map_ * weight[:, None]) + smooth
    move = splu(sparse.csc_matrix(normal)).solve(map_.T @ (weight * contacts.missing))
    move = move.reshape(-1, 3)
    length = np.linalg.norm(move, axis=1, keepdims=True)
    longest = LONGEST_STEP * contacts.missing.max()
    return np.asarray(move * np.minimum(1, longest / np.maximum(length, longest)))


def _smoothness(cage: TriMesh) -> sparse.csc_array:
    """The matrix of the quadratic form that keeps moves small and alike, (3n, 3n)."""
    count, ends = len(cage.vertices), cage.edges.ends
    rows = np.repeat(np.arange(len(ends)), 2)
    signs = np.tile([1.0, -1.0], len(ends))
    gradient = sparse.csc_array((signs, (rows, ends.ravel())), shape=(len(ends), count))
    form = SMOOTHNESS * (gradient.T @ gradient) + STIFFNESS * sparse.eye_array(count)
    return sparse.csc_array(sparse.kron(form, sparse.eye_array(3)))


def untangle(cage: TriMesh, samples: Floats, clearance: float, rounds: int = 5) -> TriMesh:
    """Push, and relax what then crosses, in turn, until nothing crosses or the rounds are over."""
    cage = push_outward(cage, samples, clearance)
    before = MOST_TANGLED + 1
    for _ in range(rounds):
        pairs = self_intersections(cage)
        if len(pairs) == 0 or len(pairs) >= before:
            break
        before = len(pairs)
        cage = push_outward(_relax(cage, np.unique(cage.faces[pairs])), samples, clearance)
    return cage


def _relax(cage: TriMesh, chosen: Integers) -> TriMesh:
    """Move vertices half the way to the mean of their neighbours."""
    ends = cage.edges.ends
    both = np.concatenate([ends, ends[:, ::-1]])
    count = np.bincount(both[:, 0], minlength=len(cage.vertices))
    mean = np.zeros_like(cage.vertices)
    np.add.at(mean, both[:, 0], cage.vertices[both[:, 1]])
    vertices = cage.vertices.copy()
    vertices[chosen] += 0.5 * (mean[chosen] / count[chosen, None] - vertices[chosen])
    return TriMesh(vertices, cage.faces)
