"""The steps of a repair that move vertices: untangle, push outward, go back where that is safe.

As few vertices as will do are moved, one after the other.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cageik_cli.cages.push import Contacts, move_to_neighbours, push
from cageik_cli.cages.surface_points import divide_triangles
from cageik_cli.geometry.intersections import crossing_face_pairs, self_intersections
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import degenerate_face_mask
from cageik_cli.geometry.surface import ClosestPoints, closest_points, winding_numbers
from cageik_cli.util.arrays import Floats, Integers

MAX_FIT_WORK = 25e6
"""Work of all rounds, as `Effort` counts it: about 25 seconds."""

MAX_RETURN_WORK = 10e6
"""Work of all trials to move vertices back."""

MAX_SHAPE_ROUNDS = 12
"""How often a cage is untangled and pushed, at most."""

MAX_FRUITLESS_ROUNDS = 4
"""A cage is given up after this many rounds in a row that found none with fewer faults."""

MAX_SIDE_PARTS = 40
"""Parts that sides of faces of the model that cross the cage are divided in, at most."""

MAX_RELAXATIONS = 12
"""How often all vertices of crossing faces are relaxed together, at most."""

MAX_SINGLE_MOVES = 60
"""Vertices moved one at a time, at most."""

MAX_MOVE_CANDIDATES = 24
"""Vertices tried before each move, those of most crossing faces first."""


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """Positions of a cage, and the moves that led to them.

    Attributes
    ----------
    untangled, pushed : (n, 3) float64
        How far each vertex was moved for either end, file units; their sum is the whole move.
    faults : int
        Crossings of the cage, points outside and crossing faces of the model; 0 if it fits.
    """

    cage: TriMesh
    untangled: Floats
    pushed: Floats
    faults: int

    @property
    def moves(self) -> Floats:
        """Return how far each vertex was moved, (n, 3)."""
        return self.untangled + self.pushed


class Effort:
    """The work that a repair may still do: counted, not timed, so that a cage always ends alike.

    A unit is about a microsecond of one processor.
    """

    def __init__(self, left: float = np.inf) -> None:
        self.left = left

    @property
    def is_spent(self) -> bool:
        """Return whether no further piece of work may begin; the last may have been too large."""
        return self.left <= 0


class ShapeFit:
    """Moves vertices of cages until they hold a model.

    Parameters
    ----------
    samples : (s, 3) float64
        Points of the model's surface.
    least : float
        Points nearer to the cage than this, or outside, are pushed for, file units,
    target : float
        to this distance.
    """

    def __init__(self, model: TriMesh, samples: Floats, least: float, target: float) -> None:
        self._model, self._samples = model, samples
        self._least, self._target = least, target
        # Points of faces that crossed the cage: they are pushed for until they have the whole
        # clearance, for what crosses lies between them.
        self._firm = np.empty((0, 3))

    def run(self, cage: TriMesh, progress: Callable[[int, int], None]) -> Shape:
        """Untangle and push in turn until nothing crosses and the model is inside.

        The work is bounded, and a cage is given up after `MAX_FRUITLESS_ROUNDS` in a row that found
        none with fewer faults.

        Returns
        -------
        Shape
            The best that was met; the cage as it was if nothing is better.
        """
        nothing = np.zeros_like(cage.vertices)
        shape = best = Shape(cage, nothing, nothing, self.count_faults(cage))
        failures, effort = 0, Effort(MAX_FIT_WORK)
        for done in range(MAX_SHAPE_ROUNDS):
            if best.faults == 0 or failures == MAX_FRUITLESS_ROUNDS or effort.is_spent:
                break
            failures += 1
            for step in (self._untangle, self._push):
                shape = step(shape, effort)
                if shape.faults < best.faults:
                    best, failures = shape, 0
            # Firm points are on faces of the model that cross the cage, their sides divided.
            corners = self._find_crossing_faces(shape.cage)
            if len(corners):
                side = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
                parts = int(np.clip(np.ceil(side / self._target), 2, MAX_SIDE_PARTS))
                points = [self._firm, corners.reshape(-1, 3), divide_triangles(corners, parts)]
                self._firm = np.unique(np.concatenate(points), axis=0)
            progress(done + 1, MAX_SHAPE_ROUNDS)
        return self._return_vertices(best, cage) if best.faults == 0 else best

    def count_faults(self, cage: TriMesh) -> int:
        """Count crossing faces of the cage, points outside, and crossing faces of the model."""
        outside = int(np.count_nonzero(measure_depths(cage, self._samples)[0] < 0))
        return (
            len(find_self_intersecting_faces(cage)) + outside + len(self._find_crossing_faces(cage))
        )

    def _untangle(self, shape: Shape, effort: Effort) -> Shape:
        flat = untangle(shape.cage, effort)
        moved = shape.untangled + flat.vertices - shape.cage.vertices
        return Shape(flat, moved, shape.pushed, self.count_faults(flat))

    def _push(self, shape: Shape, effort: Effort) -> Shape:
        if shape.faults == 0:
            return shape
        least = np.repeat([self._least, self._target], [len(self._samples), len(self._firm)])
        points = np.concatenate([self._samples, self._firm])
        pushed = push_outward(shape.cage, points, least, self._target, effort)
        moved = shape.pushed + pushed.vertices - shape.cage.vertices
        return Shape(pushed, shape.untangled, moved, self.count_faults(pushed))

    def _find_crossing_faces(self, cage: TriMesh) -> Floats:
        """Return corners of the model's faces that cross the cage, (k, 3, 3)."""
        pairs = crossing_face_pairs(self._model, cage, 0.0)
        return self._model.vertices[self._model.faces[np.unique(pairs[:, 0])]]

    def _return_vertices(self, shape: Shape, original: TriMesh) -> Shape:
        """Move vertices back to where they were, as many and as far as the cage stays fit."""
        length = np.linalg.norm(shape.moves, axis=1)
        order = np.argsort(length, kind="stable")
        effort = Effort(MAX_RETURN_WORK)
        shape, stuck = self._return_group(shape, original, order[length[order] > 0], effort)
        for vertex in reversed(stuck):
            if effort.is_spent:
                break
            # Those that cannot go all of the way back may go half of it.
            shape = self._try_return(shape, original, np.array([vertex]), 0.5, effort) or shape
        return shape

    def _return_group(
        self, shape: Shape, original: TriMesh, group: Integers, effort: Effort
    ) -> tuple[Shape, list[int]]:
        """Move a group back together, or if that fails, its halves; and which cannot go back."""
        if len(group) == 0 or effort.is_spent:
            return shape, []
        returned = self._try_return(shape, original, group, 1.0, effort)
        if returned is not None:
            return returned, []
        if len(group) == 1:
            return shape, [int(group[0])]
        stuck = []
        for half in np.array_split(group, 2):
            shape, more = self._return_group(shape, original, half, effort)
            stuck += more
        return shape, stuck

    def _try_return(
        self, shape: Shape, original: TriMesh, group: Integers, share: float, effort: Effort
    ) -> Shape | None:
        """Move vertices back by a share of their moves; return None if that shape is not fit."""
        effort.left -= 15e3
        scale = np.ones((len(shape.moves), 1))
        scale[group] = 1 - share
        moved = replace(shape, untangled=shape.untangled * scale, pushed=shape.pushed * scale)
        vertices = shape.cage.vertices.copy()
        vertices[group] = original.vertices[group] + moved.moves[group]
        after = TriMesh(vertices, original.faces)
        return replace(moved, cage=after) if self._stays_fit(shape.cage, after, group) else None

    def _stays_fit(self, before: TriMesh, after: TriMesh, group: Integers) -> bool:
        """Return whether a cage that was fit still is when some vertices were moved.

        Only what is near the faces around them, before or after, can have changed.
        """
        box = find_star_box(after, group, before.vertices[group])
        low, high = box[0] - self._target, box[1] + self._target
        samples = self._samples[((self._samples >= low) & (self._samples <= high)).all(axis=1)]
        # The surface moves no further than its vertices: what is deeper stays inside.
        longest = np.linalg.norm(after.vertices - before.vertices, axis=1).max()
        depth = closest_points(before, samples).distance
        samples = samples[depth <= longest + self._target]
        # Cheap, and true of most cages that are not fit: which side points are on costs more.
        if (closest_points(after, samples).distance < self._least).any():
            return False
        if (measure_depths(after, samples)[0] < self._least).any():
            return False
        if len(find_local_self_intersecting_faces(after, *box)):
            return False
        corners = self._model.vertices[self._model.faces]
        around = ((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)
        if not around.any():
            return True
        part = TriMesh(self._model.vertices, self._model.faces[around])
        return len(crossing_face_pairs(part, after, 0.0)) == 0


def push_outward(
    cage: TriMesh,
    samples: Floats,
    least: float | Floats,
    target: float,
    effort: Effort | None = None,
) -> TriMesh:
    """Push the cage off samples whose depth is below `least`, of each or of all, to the target.

    Vertices that need not move stay.
    """
    depths, effort = np.full(len(samples), -np.inf), effort or Effort()
    least = np.broadcast_to(least, len(samples))

    def find_contacts(cage: TriMesh, longest: float) -> Contacts | None:
        nonlocal depths
        # No point of the surface moves further than a vertex: what is deeper stays inside.
        depths = depths - longest
        near = depths < least
        if effort.is_spent or not near.any():
            return None
        effort.left -= 0.03 * near.sum() * (len(cage.faces) + 100)  # the side, and the distance
        depths[near], closest = measure_depths(cage, samples[near])
        return _make_contacts(closest, samples[near], depths[near], least[near], target)

    return push(cage, find_contacts, smoothness=0.02, stiffness=0.02)


def measure_depths(cage: TriMesh, samples: Floats) -> tuple[Floats, ClosestPoints]:
    """Measure how far inside samples are, (s,), negative outside; and find the nearest points."""
    inside = winding_numbers(cage, samples) >= 0.5
    closest = closest_points(cage, samples)
    return np.where(inside, closest.distance, -closest.distance), closest


def _make_contacts(
    closest: ClosestPoints, samples: Floats, depths: Floats, least: Floats, target: float
) -> Contacts:
    """Describe the samples whose depth is below `least`."""
    cage, chosen = closest.mesh, depths < least
    corners, nearest = cage.faces[closest.face[chosen]], closest.position[chosen]
    a, b, c = (cage.vertices[corners[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    # Barycentric weights of the nearest points; 1/3 where a face has no area.
    a, b, c = a - nearest, b - nearest, c - nearest
    parts = [np.einsum("kx,kx->k", np.cross(p, q), normal) for p, q in ((b, c), (c, a), (a, b))]
    weights = np.stack(parts, axis=1)
    total = weights.sum(axis=1, keepdims=True)
    weights = np.where(total > 0, weights / np.where(total > 0, total, 1.0), 1 / 3)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny)
    away = (nearest - samples[chosen]) * np.sign(depths[chosen])[:, None]
    length = np.linalg.norm(away, axis=1, keepdims=True)
    short = length < 1e-9 * cage.diagonal  # on the cage: its normal says where to
    direction = np.where(short, normal, away / np.where(short, 1.0, length))
    return Contacts(corners, weights, direction, target - depths[chosen])


def find_self_intersecting_faces(cage: TriMesh) -> Integers:
    """Find the faces that cross others, and those without a plane.

    Returns
    -------
    (k,), a face once for each face that it crosses; none for a cage that is free of that.
    """
    flat = np.flatnonzero(degenerate_face_mask(cage))
    return np.concatenate([self_intersections(cage).ravel(), np.repeat(flat, 2)])


def find_local_self_intersecting_faces(
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
        effort.left -= 2000 + 50 * len(numbers)
    return numbers[find_self_intersecting_faces(TriMesh(cage.vertices, cage.faces[near]))]


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
    best, fewest = cage, len(find_self_intersecting_faces(cage))
    for _ in range(MAX_RELAXATIONS):
        tangle = find_self_intersecting_faces(cage)
        for _ in range(MAX_SINGLE_MOVES):
            better = _find_best_move(cage, tangle, effort) if len(tangle) else None
            if better is None:
                break
            cage, tangle = better, find_self_intersecting_faces(better)
        if len(tangle) < fewest:
            best, fewest = cage, len(tangle)
        if len(tangle) == 0 or effort.is_spent:
            break
        chosen = np.unique(cage.faces[tangle])
        cage = TriMesh(move_to_neighbours(cage, chosen, 0.5), cage.faces)
    return best


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
        before = len(find_local_self_intersecting_faces(cage, *box, effort))
        for step in steps:
            moved = TriMesh(move_to_neighbours(cage, chosen, step), cage.faces)
            gain = before - len(find_local_self_intersecting_faces(moved, *box, effort))
            way = float(np.linalg.norm(moved.vertices[vertex] - cage.vertices[vertex]))
            # A long move must be worth it; a short one is not free either.
            merit = gain / (way / cage.diagonal + 0.02)
            if gain > 0 and merit > most:
                best, most = moved, merit
    return best
