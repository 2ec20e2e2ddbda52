"""Better angles, fewer edges at a vertex, and a tighter fit, by edits that are tested."""

from collections.abc import Iterable, Iterator
from itertools import pairwise

import numpy as np

from cageik_cli.cages.building.draft import Draft, Edit
from cageik_cli.cages.building.edits import collapse_edge, flip_edge, move_vertex, settle
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import corner_angles, cross
from cageik_cli.geometry.surface import closest_points
from cageik_cli.util.arrays import Floats, Integers

LARGEST_VALENCE = 10
"""Edges at a vertex, at most."""

GOAL = 14.0
"""Degrees at which an angle is left alone."""

KEPT_ANGLE = 10.0
"""Degrees that new faces keep where vertices are taken away, unless the old ones had less."""

GAIN = 0.3
"""Degrees that an edit for the angles must win."""

TRIED = 6
"""Edits tried for one face, the best first."""

STEPS = (0.1, 0.25, 0.5)
"""How far vertices move for better angles, over the mean length of their edges."""

TURNS = 8
"""Directions in the tangent plane that are tried."""

PULL = 0.7
"""Share of the best step that a vertex takes towards the samples."""


def mend_angles(draft: Draft, fewest: int) -> int:
    """Edit faces with angles below the goal, the worst first; return the number of edits."""
    angles = corner_angles(TriMesh(draft.vertices, draft.faces)).min(axis=1)
    worst = np.argsort(angles, kind="stable")
    made = 0
    for face in draft.faces[worst[angles[worst] < GOAL]]:
        if (draft.faces == face).all(axis=1).any():
            made += _take_best(draft, list(_angle_edits(draft, face, fewest)))
    return made


def lower_valences(draft: Draft) -> int:
    """Flip edges at vertices that have too many; return how many were flipped."""
    made = 0
    for vertex in np.flatnonzero(_valences(draft) > LARGEST_VALENCE):
        for _ in range(6):
            if _valences(draft)[vertex] <= LARGEST_VALENCE or not _flip_off(draft, int(vertex)):
                break
            made += 1
    return made


def tighten(draft: Draft, samples: Floats, chosen: Iterable[int] | None = None) -> int:
    """Move vertices, all or those chosen, towards the samples beside them; return how many moved.

    They move as far as the clearance allows.
    """
    cage = TriMesh(draft.vertices, draft.faces)
    nearest = closest_points(cage, samples)
    order = np.argsort(nearest.face, kind="stable")
    bounds = np.searchsorted(nearest.face[order], np.arange(len(cage.faces) + 1))
    by_face = [samples[order[a:b]] for a, b in pairwise(bounds)]
    rings: list[list[int]] = [[] for _ in draft.vertices]
    for number, face in enumerate(cage.faces):
        for vertex in face:
            rings[vertex].append(number)
    return sum(
        _pull(draft, vertex, np.concatenate([by_face[k] for k in rings[vertex]]))
        for vertex in (range(len(rings)) if chosen is None else sorted(chosen))
        if rings[vertex]
    )


def refill(draft: Draft, count: int) -> None:
    """Split edges until the draft has `count` vertices, the longest whose faces stay well shaped.

    A new vertex lies on the cage: the surface stays what it is.
    """
    while draft.count < count:
        ends = TriMesh(draft.vertices, draft.faces).edges.ends
        length = np.linalg.norm(draft.vertices[ends[:, 0]] - draft.vertices[ends[:, 1]], axis=1)
        valence = _valences(draft)
        for start, stop in ends[np.argsort(-length, kind="stable")]:
            if splits_well(draft, int(start), int(stop), valence, GOAL):
                draft.split(int(start), int(stop))
                break
        else:
            return


def collapse_in_shape(draft: Draft, start: int, stop: int, share: float) -> bool:
    """Collapse an edge to a point on it, if the cage stays sound and in shape.

    The point is at a share of the way from the start to the stop.
    """
    place = (1 - share) * draft.vertices[start] + share * draft.vertices[stop]
    edit = collapse_edge(draft, start, stop, place)
    if edit is None or len(edit.added) > LARGEST_VALENCE:
        return False
    needed = min(KEPT_ANGLE, float(draft.angles_before(edit).min()))
    edit = settle(draft, edit)
    return bool(draft.angles(edit).min() >= needed) and draft.take(edit)


def splits_well(draft: Draft, start: int, stop: int, valence: Integers, angle: float) -> bool:
    """Return whether halves of the faces at an edge have the angle, and vertices across room."""
    at = draft.faces_at(start)
    corners = draft.faces[at[(draft.faces[at] == stop).any(axis=1)]]
    across = corners[(corners != start) & (corners != stop)]
    if valence[across].max() >= LARGEST_VALENCE:
        return False
    middle = draft.vertices[[start, stop]].mean(axis=0)
    points = np.concatenate([draft.vertices, middle[None]])
    halves = [[end, len(draft.vertices), tip] for tip in across for end in (start, stop)]
    return bool(corner_angles(TriMesh(points, np.array(halves))).min() >= angle)


def _pull(draft: Draft, vertex: int, beside: Floats) -> bool:
    """Move a vertex so that the faces at it fit the samples beside them better."""
    if len(beside) == 0:
        return False
    still = move_vertex(draft, vertex, draft.vertices[vertex])
    directions, lack = draft.offsets(still, beside)
    normal = directions.T @ directions + 0.02 * len(lack) * np.eye(3)
    step = PULL * np.linalg.solve(normal, directions.T @ lack)
    needed = min(GOAL, float(draft.angles_before(still).min()))
    before = _misfit(draft, still, beside)
    for share in (1.0, 0.4):
        edit = move_vertex(draft, vertex, draft.vertices[vertex] + share * step)
        edit = settle(draft, edit)
        better = _misfit(draft, edit, beside) < 0.995 * before
        if better and draft.angles(edit).min() >= needed and draft.take(edit):
            return True
    return False


def _misfit(draft: Draft, edit: Edit, beside: Floats) -> float:
    """Return mean square of the samples' distance from the faces of an edit."""
    return float(np.mean(closest_points(draft.patch(edit), beside).distance ** 2))


def _take_best(draft: Draft, edits: list[Edit]) -> bool:
    """Make the edit after which the smallest angle is largest, of those that are sound."""
    gains = [_gain(draft, edit) for edit in edits]
    for k in np.argsort(gains, kind="stable")[::-1][:TRIED]:
        if gains[k] < GAIN:
            return False
        edit = settle(draft, edits[k]) if len(edits[k].added) != 2 else edits[k]
        if _gain(draft, edit) >= GAIN and draft.take(edit):
            return True
    return False


def _gain(draft: Draft, edit: Edit) -> float:
    """Return how much an edit raises the smallest angle where it is, up to the goal, degrees."""
    after = min(GOAL, float(draft.angles(edit).min()))
    return after - float(draft.angles_before(edit).min())


def _angle_edits(draft: Draft, face: Integers, fewest: int) -> Iterator[Edit]:
    """Return edits that may improve a face."""
    valence = _valences(draft)
    corners = draft.vertices[face]
    lengths = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    for k in range(3):
        start, stop = int(face[k]), int(face[k - 2])
        flip = flip_edge(draft, start, stop)
        if flip is not None and valence[flip.added[:, [0, 2]]].max() < LARGEST_VALENCE:
            yield flip
        yield from _moves(draft, start)
    short = int(lengths.argmin())
    start, stop = int(face[short]), int(face[short - 2])
    if draft.count > fewest:
        for position in (draft.vertices[[start, stop]].mean(axis=0), draft.vertices[start]):
            merged = collapse_edge(draft, start, stop, position)
            if merged is not None and len(merged.added) <= LARGEST_VALENCE:
                yield merged


def _moves(draft: Draft, vertex: int) -> Iterator[Edit]:
    """Return moves of a vertex in its tangent plane, and outward."""
    around = draft.faces_at(vertex)
    corners = draft.vertices[draft.faces[around]]
    normal = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    normal /= max(np.linalg.norm(normal), 1e-300)
    across = cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    along = cross(normal, across)
    here = draft.vertices[vertex]
    length = np.linalg.norm(draft.vertices[draft.neighbours(vertex)] - here, axis=1).mean()
    for step in STEPS:
        for turn in 2 * np.pi * np.arange(TURNS) / TURNS:
            way = np.cos(turn) * across + np.sin(turn) * along
            yield move_vertex(draft, vertex, here + step * length * way)
        yield move_vertex(draft, vertex, here + step * length * normal)


def _valences(draft: Draft) -> Integers:
    """Return faces at each vertex, which are as many as its edges."""
    return np.bincount(draft.faces.ravel(), minlength=len(draft.vertices))


def _flip_off(draft: Draft, vertex: int) -> bool:
    """Flip an edge away from a vertex, the one that leaves the best angles."""
    flips = [flip_edge(draft, vertex, int(other)) for other in draft.neighbours(vertex)]
    valence = _valences(draft)
    kept = [
        flip
        for flip in flips
        if flip is not None and valence[flip.added[:, [0, 2]]].max() < LARGEST_VALENCE
    ]
    kept.sort(key=lambda flip: -float(draft.angles(flip).min()))
    needed = 0.5 * GOAL
    return any(draft.angles(f).min() >= needed and draft.take(f) for f in kept)
