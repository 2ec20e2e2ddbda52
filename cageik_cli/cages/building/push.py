"""Move a cage outward until points of the model have their clearance, and untangle it."""

import igl
import numpy as np

from cageik_cli.cages.contacts import Contacts, MoveCosts, solve_moves
from cageik_cli.cages.relaxation import move_to_neighbours
from cageik_cli.geometry.intersections import self_intersections
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import winding_numbers
from cageik_cli.util.arrays import Floats

ROUNDS = 30
"""Pushes, at most."""

PATIENCE = 6
"""Pushes end when the largest distance that is missing has not shrunk in so many."""

MOST_TANGLED = 60
"""Pairs of faces that cross, above which a cage is not worth untangling."""

COSTS = MoveCosts(smoothness=0.05, stiffness=0.005)
"""The cost of moves; a lower stiffness than in a repair lets parts move as a whole."""

RELAX_STEP = 0.5
"""The share of the way to their neighbours that vertices of crossing faces are moved."""

MARGIN = 1.03
"""Pushes aim at this many clearances"""

REACHED = 1.015
"""and end with this many."""


def push_outward(cage: TriMesh, samples: Floats, clearance: float) -> TriMesh:
    """Move the cage until the samples have the clearance, or pushes stop helping.

    Every push is a least-squares problem in all vertices: what is missing along the directions of
    contacts, neighbours moving alike.
    """
    form = COSTS.make_form(cage)
    vertices = cage.vertices
    history: list[float] = []
    for _ in range(ROUNDS):
        contacts = find_contacts(TriMesh(vertices, cage.faces), samples, MARGIN * clearance)
        if len(contacts.missing) == 0 or contacts.missing.max() < (MARGIN - REACHED) * clearance:
            break
        history.append(float(contacts.missing.max()))
        if len(history) > PATIENCE and history[-1] > 0.9 * history[-1 - PATIENCE]:
            break
        vertices = vertices + solve_moves(contacts, form)
    return TriMesh(vertices, cage.faces)


def find_contacts(cage: TriMesh, samples: Floats, clearance: float) -> Contacts:
    """Return the samples with less than the clearance."""
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


def untangle(cage: TriMesh, samples: Floats, clearance: float, rounds: int = 5) -> TriMesh:
    """Push, and relax what then crosses, in turn, until nothing crosses or the rounds are over."""
    cage = push_outward(cage, samples, clearance)
    before = MOST_TANGLED + 1
    for _ in range(rounds):
        pairs = self_intersections(cage)
        if len(pairs) == 0 or len(pairs) >= before:
            break
        before = len(pairs)
        vertices = move_to_neighbours(cage, np.unique(cage.faces[pairs]), RELAX_STEP)
        cage = push_outward(TriMesh(vertices, cage.faces), samples, clearance)
    return cage
