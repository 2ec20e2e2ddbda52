"""The steps of a repair that move vertices: untangle, push outward, go back where that is safe."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cageik_cli.cages.repairing.push import Clearance, find_contacts, push_outward
from cageik_cli.cages.repairing.samples import divide_triangles
from cageik_cli.cages.repairing.untangle import (
    find_local_tangle,
    find_star_box,
    find_tangle,
    untangle,
)
from cageik_cli.geometry.intersections import crossing_face_pairs
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats

MAX_ROUNDS = 20
"""How often a cage is untangled and pushed, at most."""

RETURN_SHARES = (1.0, 0.5)
"""Shares of the way back to where it was that are tried for each vertex."""

CROSSING_PARTS = 8
"""Sides of faces of the model that cross the cage are divided in so many."""


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """What a cage must hold.

    Attributes
    ----------
    model : TriMesh
    samples : (s, 3) float64
        Points of its surface.
    clearance : Clearance
    """

    model: TriMesh
    samples: Floats
    clearance: Clearance


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """Positions of a cage, and how they came about.

    Attributes
    ----------
    cage : TriMesh
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
        """How far each vertex was moved, (n, 3)."""
        return self.untangled + self.pushed


def fit_shape(cage: TriMesh, target: Target, progress: Callable[[int, int], None]) -> Shape:
    """Untangle and push in turn until nothing crosses and the model is inside.

    Returns
    -------
    Shape
        The best that was met; the cage as it was if nothing is better.
    """
    nothing = np.zeros_like(cage.vertices)
    shape = best = Shape(cage, nothing, nothing, count_faults(cage, target))
    for done in range(MAX_ROUNDS):
        if best.faults == 0:
            break
        for step in (_untangle_shape, _push_shape):
            shape = step(shape, target)
            if shape.faults < best.faults:
                best = shape
        target = replace(target, samples=_add_crossing_samples(shape.cage, target))
        progress(done + 1, MAX_ROUNDS)
    return _return_vertices(best, cage, target) if best.faults == 0 else best


def count_faults(cage: TriMesh, target: Target) -> int:
    """Faces of the cage that cross others, points outside, and crossing faces of the model."""
    reach = replace(target.clearance, least=0.0)
    outside = len(find_contacts(cage, target.samples, reach).missing)
    return find_tangle(cage).size + outside + len(_find_crossing_faces(cage, target.model))


def _untangle_shape(shape: Shape, target: Target) -> Shape:
    flat = untangle(shape.cage)
    moved = shape.untangled + flat.vertices - shape.cage.vertices
    return Shape(flat, moved, shape.pushed, count_faults(flat, target))


def _push_shape(shape: Shape, target: Target) -> Shape:
    if shape.faults == 0:
        return shape
    pushed = push_outward(shape.cage, target.samples, target.clearance)
    moved = shape.pushed + pushed.vertices - shape.cage.vertices
    return Shape(pushed, shape.untangled, moved, count_faults(pushed, target))


def _find_crossing_faces(cage: TriMesh, model: TriMesh) -> Floats:
    """Corners of the model's faces that cross the cage, (k, 3, 3)."""
    pairs = crossing_face_pairs(model, cage, 0.0)
    return model.vertices[model.faces[np.unique(pairs[:, 0])]]


def _add_crossing_samples(cage: TriMesh, target: Target) -> Floats:
    """The samples, and more of them on faces of the model that cross the cage."""
    added = divide_triangles(_find_crossing_faces(cage, target.model), CROSSING_PARTS)
    return np.concatenate([target.samples, added])


def _return_vertices(shape: Shape, original: TriMesh, target: Target) -> Shape:
    """Move vertices back, one after the other, as far as the cage stays fit."""
    order = np.argsort(-np.linalg.norm(shape.moves, axis=1), kind="stable")
    for vertex in order[(shape.moves[order] != 0).any(axis=1)].tolist():
        for share in RETURN_SHARES:
            scale = np.ones(len(order))
            scale[vertex] = 1 - share
            moved = replace(
                shape,
                untangled=shape.untangled * scale[:, None],
                pushed=shape.pushed * scale[:, None],
            )
            vertices = shape.cage.vertices.copy()
            vertices[vertex] = original.vertices[vertex] + moved.moves[vertex]
            moved = replace(moved, cage=TriMesh(vertices, original.faces))
            if _stays_fit(shape.cage, moved.cage, vertex, target):
                shape = moved
                break
    return shape


def _stays_fit(before: TriMesh, after: TriMesh, vertex: int, target: Target) -> bool:
    """Whether a cage that was fit still is when one vertex was moved.

    Only what is near the faces around the vertex, before or after, can have changed.
    """
    box = find_star_box(after, vertex, before.vertices[vertex])
    if find_local_tangle(after, *box).size:
        return False
    low, high = box[0] - target.clearance.target, box[1] + target.clearance.target
    near = ((target.samples >= low) & (target.samples <= high)).all(axis=1)
    if len(find_contacts(after, target.samples[near], target.clearance).missing):
        return False
    corners = target.model.vertices[target.model.faces]
    around = ((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)
    if not around.any():
        return True
    part = TriMesh(target.model.vertices, target.model.faces[around])
    return len(crossing_face_pairs(part, after, 0.0)) == 0
