"""Move vertices whose faces cross others: as few of them as will do, one after the other."""

import numpy as np

from cageik_cli.cages.push import move_to_neighbours
from cageik_cli.geometry.intersections import self_intersections
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import degenerate_face_mask
from cageik_cli.util.arrays import Floats, Integers

MAX_RELAXATIONS = 12
"""How often all vertices of crossing faces are relaxed together, at most."""

MAX_SINGLE_MOVES = 60
"""Vertices moved one at a time, at most."""

MAX_MOVE_CANDIDATES = 24
"""Vertices tried before each move, those of most crossing faces first."""


class Effort:
    """The work that a repair may still do: counted, not timed, so that a cage always ends alike.

    A unit is about a microsecond of one processor.
    """

    def __init__(self, left: float = np.inf) -> None:
        self._left = left

    @property
    def is_spent(self) -> bool:
        """Return whether no further piece of work may begin."""
        return self._left <= 0

    def spend(self, amount: float) -> None:
        """Count some work; the last piece may be larger than what was left."""
        self._left -= amount

    def spend_on_tangle(self, faces: int) -> None:
        """Count a search for crossings among faces."""
        self.spend(2000.0 + 50.0 * faces)

    def spend_on_samples(self, samples: int, faces: int) -> None:
        """Count the measurement of samples in a cage of so many faces: side and distance."""
        self.spend(0.03 * samples * (faces + 100))


def find_tangle(cage: TriMesh) -> Integers:
    """Find the faces that cross others, and those without a plane.

    Returns
    -------
    (k,), a face once for each face that it crosses; none for a cage that is free of that.
    """
    flat = np.flatnonzero(degenerate_face_mask(cage))
    return np.concatenate([self_intersections(cage).ravel(), np.repeat(flat, 2)])


def find_local_tangle(
    cage: TriMesh, low: Floats, high: Floats, effort: Effort | None = None
) -> Integers:
    """Find the tangle of the faces that reach into the box between `low` and `high`, (3,).

    Of vertices that move within a box, nothing else changes.
    """
    corners = cage.vertices[cage.faces]
    near = ((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)
    numbers = np.flatnonzero(near)
    if len(numbers) == 0:
        return numbers
    if effort is not None:
        effort.spend_on_tangle(len(numbers))
    return numbers[find_tangle(TriMesh(cage.vertices, cage.faces[near]))]


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
    effort = effort or Effort()
    best, fewest = cage, len(find_tangle(cage))
    for _ in range(MAX_RELAXATIONS):
        cage = _move_single_vertices(cage, effort)
        tangle = find_tangle(cage)
        if len(tangle) < fewest:
            best, fewest = cage, len(tangle)
        if len(tangle) == 0 or effort.is_spent:
            break
        chosen = np.unique(cage.faces[tangle])
        cage = TriMesh(move_to_neighbours(cage, chosen, 0.5), cage.faces)
    return best


def _move_single_vertices(cage: TriMesh, effort: Effort) -> TriMesh:
    tangle = find_tangle(cage)
    for _ in range(MAX_SINGLE_MOVES):
        if len(tangle) == 0:
            break
        better = _find_best_move(cage, tangle, effort)
        if better is None:
            break
        cage, tangle = better, find_tangle(better)
    return cage


def _find_best_move(cage: TriMesh, tangle: Integers, effort: Effort) -> TriMesh | None:
    """Find the move of a vertex that resolves most crossings for its length; None without one.

    The vertices of most crossing faces are tried, each at shares of the way to the mean of its
    neighbours.
    """
    steps = (0.25, 0.5, 1.0)
    share = np.bincount(cage.faces[tangle].ravel(), minlength=len(cage.vertices))
    order = np.argsort(-share, kind="stable")[:MAX_MOVE_CANDIDATES]
    best, most = None, 0.0
    for vertex in order[share[order] > 0].tolist():
        if effort.is_spent:
            break
        chosen = np.array([vertex])
        box = find_star_box(cage, chosen, move_to_neighbours(cage, chosen, max(steps))[chosen])
        before = len(find_local_tangle(cage, *box, effort))
        for step in steps:
            moved = TriMesh(move_to_neighbours(cage, chosen, step), cage.faces)
            gain = before - len(find_local_tangle(moved, *box, effort))
            way = float(np.linalg.norm(moved.vertices[vertex] - cage.vertices[vertex]))
            # A long move must be worth it; a short one is not free either.
            merit = gain / (way / cage.diagonal + 0.02)
            if gain > 0 and merit > most:
                best, most = moved, merit
    return best
