"""Move vertices whose faces cross others: as few of them as will do, one after the other."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.cages.relaxation import move_to_neighbours
from cageik_cli.cages.repairing.effort import Effort
from cageik_cli.geometry.intersections import self_intersections
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import degenerate_face_mask
from cageik_cli.util.arrays import Floats, Integers

STEPS = (0.25, 0.5, 1.0)
"""Shares of the way to the mean of its neighbours that are tried for a vertex."""

MAX_MOVES = 60
"""Vertices moved one at a time, at most."""

MAX_CANDIDATES = 24
"""Vertices tried before each move, those of most crossing faces first."""

MAX_RELAXATIONS = 12
"""How often all vertices of crossing faces are relaxed together, at most."""


@dataclass(frozen=True, slots=True, eq=False)
class Tangle:
    """Which faces of a cage cross others, or have no plane.

    Attributes
    ----------
    faces : (k,) int64
        A face once for each face that it crosses.
    """

    faces: Integers

    @property
    def size(self) -> int:
        """Return how much is wrong: 0 for a cage that is free of it."""
        return len(self.faces)


def find_tangle(cage: TriMesh) -> Tangle:
    """Find the faces that cross others, and those without a plane."""
    flat = np.flatnonzero(degenerate_face_mask(cage))
    return Tangle(np.concatenate([self_intersections(cage).ravel(), np.repeat(flat, 2)]))


def find_local_tangle(
    cage: TriMesh, low: Floats, high: Floats, effort: Effort | None = None
) -> Tangle:
    """Find the tangle of the faces that reach into the box between `low` and `high`, (3,).

    Of vertices that move within a box, nothing else changes.
    """
    corners = cage.vertices[cage.faces]
    near = ((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)
    numbers = np.flatnonzero(near)
    if len(numbers) == 0:
        return Tangle(numbers)
    if effort is not None:
        effort.spend_on_tangle(len(numbers))
    return Tangle(numbers[find_tangle(TriMesh(cage.vertices, cage.faces[near])).faces])


def find_star_box(cage: TriMesh, group: Integers, others: Floats) -> tuple[Floats, Floats]:
    """Return the box of the faces around vertices and of `others`, their other places (k, 3)."""
    star = cage.faces[np.isin(cage.faces, group).any(axis=1)]
    points = np.concatenate([cage.vertices[star].reshape(-1, 3), others])
    return points.min(axis=0), points.max(axis=0)


def untangle(cage: TriMesh, effort: Effort | None = None) -> TriMesh:
    """Move single vertices while that leaves fewer crossings; if it does not, relax all of them.

    Returns the cage with the fewest crossings that was met until the effort ends, the one given if
    there is no better.
    """
    effort = effort or Effort(np.inf)
    best, fewest = cage, find_tangle(cage).size
    for _ in range(MAX_RELAXATIONS):
        cage = _move_single_vertices(cage, effort)
        tangle = find_tangle(cage)
        if tangle.size < fewest:
            best, fewest = cage, tangle.size
        if tangle.size == 0 or effort.is_spent:
            break
        chosen = np.unique(cage.faces[tangle.faces])
        cage = TriMesh(move_to_neighbours(cage, chosen, 0.5), cage.faces)
    return best


def _move_single_vertices(cage: TriMesh, effort: Effort) -> TriMesh:
    tangle = find_tangle(cage)
    for _ in range(MAX_MOVES):
        if tangle.size == 0:
            break
        better = _find_best_move(cage, tangle, effort)
        if better is None:
            break
        cage, tangle = better, find_tangle(better)
    return cage


def _find_best_move(cage: TriMesh, tangle: Tangle, effort: Effort) -> TriMesh | None:
    """Find the move of a vertex that resolves most crossings for its length; None without one."""
    share = np.bincount(cage.faces[tangle.faces].ravel(), minlength=len(cage.vertices))
    order = np.argsort(-share, kind="stable")[:MAX_CANDIDATES]
    best, most = None, 0.0
    for vertex in order[share[order] > 0].tolist():
        if effort.is_spent:
            break
        chosen = np.array([vertex])
        box = find_star_box(cage, chosen, move_to_neighbours(cage, chosen, max(STEPS))[chosen])
        before = find_local_tangle(cage, *box, effort).size
        for step in STEPS:
            moved = TriMesh(move_to_neighbours(cage, chosen, step), cage.faces)
            gain = before - find_local_tangle(moved, *box, effort).size
            way = float(np.linalg.norm(moved.vertices[vertex] - cage.vertices[vertex]))
            # A long move must be worth it; a short one is not free either.
            merit = gain / (way / cage.diagonal + 0.02)
            if gain > 0 and merit > most:
                best, most = moved, merit
    return best
