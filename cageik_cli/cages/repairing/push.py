"""Move a cage outward, and no more of it than must be, until it holds points of the model."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.cages.contacts import Contacts, MoveCosts, solve_moves
from cageik_cli.cages.repairing.effort import Effort
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import ClosestPoints, closest_points, winding_numbers
from cageik_cli.util.arrays import Floats

MAX_ROUNDS = 30
"""How often all vertices are moved, at most."""

PATIENCE = 6
"""Pushes end when what is missing most has not shrunk in so many of them"""

MIN_PROGRESS = 0.9
"""to this share."""

COSTS = MoveCosts(smoothness=0.02, stiffness=0.02)
"""The cost of moves: vertices that need not move stay."""

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

    def take(self, chosen: NDArray[np.bool_]) -> "Clearance":
        """Return the clearance of some of the points, (s,)."""
        least = self.least if isinstance(self.least, float) else self.least[chosen]
        return Clearance(least, self.target)


def push_outward(
    cage: TriMesh, samples: Floats, clearance: Clearance, effort: Effort | None = None
) -> TriMesh:
    """Move the cage until the samples have the clearance, pushes stop helping, or effort ends.

    Each round is a least-squares problem in all vertices: what is missing along the directions of
    contacts, against the moves themselves and their differences between neighbours.
    """
    effort = effort or Effort(np.inf)
    form = COSTS.make_form(cage)
    heights = np.full(len(samples), -np.inf)  # or less than those are
    deepest: list[float] = []
    for _ in range(MAX_ROUNDS):
        near = heights < clearance.least
        if not near.any() or effort.is_spent:
            break
        effort.spend_on_samples(int(near.sum()), len(cage.faces))
        heights[near], closest = measure_heights(cage, samples[near])
        contacts = _make_contacts(closest, samples[near], heights[near], clearance.take(near))
        if len(contacts.missing) == 0:
            break
        deepest.append(float(contacts.missing.max()))
        if len(deepest) > PATIENCE and deepest[-1] > MIN_PROGRESS * deepest[-1 - PATIENCE]:
            break
        moves = solve_moves(contacts, form)
        cage = TriMesh(cage.vertices + moves, cage.faces)
        # No point of the surface moves further than a vertex: what is deeper stays inside.
        heights -= np.linalg.norm(moves, axis=1).max()
    return cage


def find_contacts(cage: TriMesh, samples: Floats, clearance: Clearance) -> Contacts:
    """Find the samples that are outside, or nearer to the cage than they may be."""
    heights, closest = measure_heights(cage, samples)
    return _make_contacts(closest, samples, heights, clearance)


def measure_heights(cage: TriMesh, samples: Floats) -> tuple[Floats, ClosestPoints]:
    """Measure how far inside samples are, (s,), negative outside; and find the nearest points."""
    inside = winding_numbers(cage, samples) >= 0.5
    closest = closest_points(cage, samples)
    return np.where(inside, closest.distance, -closest.distance), closest


def _make_contacts(
    closest: ClosestPoints, samples: Floats, height: Floats, clearance: Clearance
) -> Contacts:
    cage, chosen = closest.mesh, height < clearance.least
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
    """Return the weights of points (k, 3) in triangles (k, 3, 3); 1/3 where there is no area."""
    a, b, c = (triangles[:, k] - points for k in range(3))
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    parts = [np.einsum("kx,kx->k", np.cross(p, q), normal) for p, q in ((b, c), (c, a), (a, b))]
    weights = np.stack(parts, axis=1)
    total = weights.sum(axis=1, keepdims=True)
    return np.where(total > 0, weights / np.where(total > 0, total, 1.0), 1 / 3)
