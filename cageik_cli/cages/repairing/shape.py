"""The steps of a repair that move vertices: untangle, push outward, go back where that is safe."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from cageik_cli.cages.repairing.effort import Effort
from cageik_cli.cages.repairing.push import Clearance, find_contacts, push_outward
from cageik_cli.cages.repairing.untangle import (
    find_local_tangle,
    find_star_box,
    find_tangle,
    untangle,
)
from cageik_cli.cages.surface_points import divide_triangles
from cageik_cli.geometry.intersections import crossing_face_pairs
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import closest_points
from cageik_cli.util.arrays import Floats, Integers

MAX_ROUNDS = 12
"""How often a cage is untangled and pushed, at most."""

PATIENCE = 4
"""A cage is given up when so many rounds that follow each other found none with fewer faults."""

MAX_WORK = 25e6
"""Work of all rounds, as `Effort` counts it: about 25 seconds."""

RETURN_WORK, MAX_RETURN_WORK = 15e3, 10e6
"""Work of a trial to move vertices back, and of all of them."""

RETURN_SHARE = 0.5
"""Share of the way back that is tried for vertices that cannot go all of it."""

MAX_PARTS = 40
"""Sides of faces of the model that cross the cage are divided in so many, at most."""


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """The points and faces that a cage must hold.

    Attributes
    ----------
    samples : (s, 3) float64
        Points of its surface.
    firm : (k, 3) float64
        Points of faces that crossed the cage: they are pushed for until they have the whole
        clearance, for what crosses lies between them.
    """

    model: TriMesh
    samples: Floats
    clearance: Clearance
    firm: Floats = field(default_factory=lambda: np.empty((0, 3)))


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


def fit_shape(cage: TriMesh, target: Target, progress: Callable[[int, int], None]) -> Shape:
    """Untangle and push in turn until nothing crosses and the model is inside.

    The work is bounded.

    Returns
    -------
    Shape
        The best that was met; the cage as it was if nothing is better.
    """
    nothing = np.zeros_like(cage.vertices)
    shape = best = Shape(cage, nothing, nothing, count_faults(cage, target))
    failures, effort = 0, Effort(MAX_WORK)
    for done in range(MAX_ROUNDS):
        if best.faults == 0 or failures == PATIENCE or effort.is_spent:
            break
        failures += 1
        for step in (_untangle_shape, _push_shape):
            shape = step(shape, target, effort)
            if shape.faults < best.faults:
                best, failures = shape, 0
        target = _add_crossing_samples(shape.cage, target)
        progress(done + 1, MAX_ROUNDS)
    return _return_vertices(best, cage, target) if best.faults == 0 else best


def count_faults(cage: TriMesh, target: Target) -> int:
    """Count crossing faces of the cage, points outside, and crossing faces of the model."""
    reach = replace(target.clearance, least=0.0)
    outside = len(find_contacts(cage, target.samples, reach).missing)
    return find_tangle(cage).size + outside + len(_find_crossing_faces(cage, target.model))


def _untangle_shape(shape: Shape, target: Target, effort: Effort) -> Shape:
    flat = untangle(shape.cage, effort)
    moved = shape.untangled + flat.vertices - shape.cage.vertices
    return Shape(flat, moved, shape.pushed, count_faults(flat, target))


def _push_shape(shape: Shape, target: Target, effort: Effort) -> Shape:
    if shape.faults == 0:
        return shape
    clearance, counts = target.clearance, (len(target.samples), len(target.firm))
    least = np.repeat([clearance.least, clearance.target], counts)
    points = np.concatenate([target.samples, target.firm])
    pushed = push_outward(shape.cage, points, Clearance(least, clearance.target), effort)
    moved = shape.pushed + pushed.vertices - shape.cage.vertices
    return Shape(pushed, shape.untangled, moved, count_faults(pushed, target))


def _find_crossing_faces(cage: TriMesh, model: TriMesh) -> Floats:
    """Return corners of the model's faces that cross the cage, (k, 3, 3)."""
    pairs = crossing_face_pairs(model, cage, 0.0)
    return model.vertices[model.faces[np.unique(pairs[:, 0])]]


def _add_crossing_samples(cage: TriMesh, target: Target) -> Target:
    """Add firm points on the faces of the model that cross the cage."""
    corners = _find_crossing_faces(cage, target.model)
    if len(corners) == 0:
        return target
    side = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
    parts = int(np.clip(np.ceil(side / target.clearance.target), 2, MAX_PARTS))
    points = [target.firm, corners.reshape(-1, 3), divide_triangles(corners, parts)]
    return replace(target, firm=np.unique(np.concatenate(points), axis=0))


def _return_vertices(shape: Shape, original: TriMesh, target: Target) -> Shape:
    """Move vertices back to where they were, as many and as far as the cage stays fit."""
    length = np.linalg.norm(shape.moves, axis=1)
    order = np.argsort(length, kind="stable")
    effort = Effort(MAX_RETURN_WORK)
    shape, stuck = _return_group(shape, original, target, order[length[order] > 0], effort)
    for vertex in reversed(stuck):
        if effort.is_spent:
            break
        effort.spend(RETURN_WORK)
        shape = _try_return(shape, original, target, np.array([vertex]), RETURN_SHARE) or shape
    return shape


def _return_group(
    shape: Shape, original: TriMesh, target: Target, group: Integers, effort: Effort
) -> tuple[Shape, list[int]]:
    """Move a group back together, or if that fails, its halves; and which vertices cannot go."""
    if len(group) == 0 or effort.is_spent:
        return shape, []
    effort.spend(RETURN_WORK)
    returned = _try_return(shape, original, target, group, 1.0)
    if returned is not None:
        return returned, []
    if len(group) == 1:
        return shape, [int(group[0])]
    stuck = []
    for half in np.array_split(group, 2):
        shape, more = _return_group(shape, original, target, half, effort)
        stuck += more
    return shape, stuck


def _try_return(
    shape: Shape, original: TriMesh, target: Target, group: Integers, share: float
) -> Shape | None:
    """Move vertices back by a share of their moves; return None if that shape is not fit."""
    scale = np.ones((len(shape.moves), 1))
    scale[group] = 1 - share
    moved = replace(shape, untangled=shape.untangled * scale, pushed=shape.pushed * scale)
    vertices = shape.cage.vertices.copy()
    vertices[group] = original.vertices[group] + moved.moves[group]
    after = TriMesh(vertices, original.faces)
    return replace(moved, cage=after) if _stays_fit(shape.cage, after, group, target) else None


def _stays_fit(before: TriMesh, after: TriMesh, group: Integers, target: Target) -> bool:
    """Return whether a cage that was fit still is when some vertices were moved.

    Only what is near the faces around them, before or after, can have changed.
    """
    box = find_star_box(after, group, before.vertices[group])
    low, high = box[0] - target.clearance.target, box[1] + target.clearance.target
    samples = target.samples[((target.samples >= low) & (target.samples <= high)).all(axis=1)]
    # The surface moves no further than its vertices: what is deeper stays inside.
    longest = np.linalg.norm(after.vertices - before.vertices, axis=1).max()
    depth = closest_points(before, samples).distance
    samples = samples[depth <= longest + target.clearance.target]
    # Cheap, and true of most cages that are not fit: which side points are on costs more.
    if (closest_points(after, samples).distance < target.clearance.least).any():
        return False
    if len(find_contacts(after, samples, target.clearance).missing):
        return False
    if find_local_tangle(after, *box).size:
        return False
    corners = target.model.vertices[target.model.faces]
    around = ((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)
    if not around.any():
        return True
    part = TriMesh(target.model.vertices, target.model.faces[around])
    return len(crossing_face_pairs(part, after, 0.0)) == 0
