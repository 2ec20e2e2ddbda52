"""Better angles, fewer edges at a vertex, and a tighter fit, by edits that are tested.

An edit moves a vertex, flips an edge or collapses one.
"""

from collections.abc import Iterable, Iterator

import igl
import numpy as np
from scipy.optimize import nnls

from cageik_cli.cages.builder.draft import (
    MIN_KEPT_ANGLE,
    Draft,
    Edit,
    collapse_edge,
    flip_edge,
    move_vertex,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import cross, measure_angles
from cageik_cli.geometry.surface import closest_points
from cageik_cli.util.arrays import Floats, Integers

MAX_VALENCE = 10
"""Edges at a vertex, at most."""

MIN_WANTED_ANGLE = 14.0
"""Degrees at which an angle is left alone."""

MIN_ANGLE_GAIN = 0.3
"""Degrees that an edit for the angles must win."""

ANGLE_DECIMALS = 2
"""Digits of angles and of their gains, degrees, by which faces and edits are ordered: many are
alike, and rounding is not to choose between them."""

DEGREES_PER_GROWTH = 400.0
"""Degrees that an edit for the angles must win for as much volume as the cage has: four for one
percent. Otherwise a round cage grows by a spike for every needle."""

MAX_TRIED_EDITS = 6
"""Edits tried for one face, the best first."""

MIN_MOVED_SHARE = 1e-6
"""The barycentric share of a vertex in a point that moves with it; less is rounding."""

MAX_SETTLING_STEPS = 5
"""Steps in which a moved vertex looks for a place that keeps off the samples."""


def improve_angles(draft: Draft, fewest: int) -> int:
    """Edit faces with angles below the goal, the worst first; return the number of edits."""
    angles = measure_angles(draft.vertices[draft.faces]).min(axis=1)
    worst = np.argsort(angles.round(ANGLE_DECIMALS), kind="stable")
    made = 0
    for face in draft.faces[worst[angles[worst] < MIN_WANTED_ANGLE]]:
        if (draft.faces == face).all(axis=1).any():
            made += _take_best(draft, list(_angle_edits(draft, face, fewest)))
    return made


def lower_valences(draft: Draft) -> int:
    """Flip edges at vertices that have too many; return how many were flipped.

    The edge that leaves the best angles is flipped first.
    """
    made = 0
    for vertex in np.flatnonzero(draft.count_faces() > MAX_VALENCE).tolist():
        for _ in range(6):
            valence = draft.count_faces()
            if valence[vertex] <= MAX_VALENCE:
                break
            flips = [flip_edge(draft, vertex, int(other)) for other in draft.neighbours(vertex)]
            kept = [flip for flip in flips if flip is not None and _has_room(flip, valence)]
            kept.sort(key=lambda flip: -float(draft.angles(flip).min()))
            needed = 0.5 * MIN_WANTED_ANGLE
            if not any(draft.angles(f).min() >= needed and draft.take(f) for f in kept):
                break
            made += 1
    return made


def _has_room(flip: Edit, valence: Integers) -> bool:
    """Return whether the vertices that a flip joins may have one more edge."""
    return bool(valence[flip.added[:, [0, 2]]].max() < MAX_VALENCE)


def tighten(draft: Draft, samples: Floats, chosen: Iterable[int] | None = None) -> int:
    """Move vertices, all or those chosen, towards the samples beside them; return how many moved.

    They move as far as the clearance allows. Samples are beside a vertex whose nearest points on
    the cage move with it: at an edge, that does not hang on which of its two faces is found.
    """
    cage = TriMesh(draft.vertices, draft.faces)
    nearest = closest_points(cage, samples)
    corners = cage.faces[nearest.face]
    a, b, c = (cage.vertices[corners[:, k]] for k in range(3))
    shares = igl.barycentric_coordinates(nearest.position.copy(), a, b, c)
    sample, corner = np.nonzero(shares.reshape(-1, 3) > MIN_MOVED_SHARE)
    vertex = corners[sample, corner]
    by_vertex = sample[np.argsort(vertex, kind="stable")]
    bounds = np.searchsorted(np.sort(vertex), np.arange(len(cage.vertices) + 1))
    return sum(
        _pull(draft, k, samples[by_vertex[bounds[k] : bounds[k + 1]]])
        for k in (range(len(cage.vertices)) if chosen is None else sorted(chosen))
    )


def refill(draft: Draft, count: int) -> None:
    """Split edges until the draft has `count` vertices, the longest whose faces stay well shaped.

    A new vertex lies on the cage: the surface stays what it is.
    """
    while draft.count < count:
        ends = TriMesh(draft.vertices, draft.faces).edges.ends
        length = np.linalg.norm(draft.vertices[ends[:, 0]] - draft.vertices[ends[:, 1]], axis=1)
        valence = draft.count_faces()
        for start, stop in ends[np.argsort(-length, kind="stable")].tolist():
            has_room = draft.count + draft.count_split(start, stop) <= count
            if has_room and splits_well(draft, start, stop, valence, MIN_WANTED_ANGLE):
                draft.split(start, stop)
                break
        else:
            return


def collapse_in_shape(draft: Draft, start: int, stop: int, share: float) -> bool:
    """Collapse an edge to a point on it, if the cage stays sound and in shape.

    The point is at a share of the way from the start to the stop.
    """
    place = (1 - share) * draft.vertices[start] + share * draft.vertices[stop]
    edit = collapse_edge(draft, start, stop, place)
    if edit is None or len(edit.added) > MAX_VALENCE:
        return False
    needed = min(MIN_KEPT_ANGLE, float(draft.angles_before(edit).min()))
    edit = settle(draft, edit)
    return bool(draft.angles(edit).min() >= needed) and draft.take(edit)


def splits_well(draft: Draft, start: int, stop: int, valence: Integers, angle: float) -> bool:
    """Return whether halves of the faces at an edge have the angle, and vertices across room."""
    if not draft.is_divisible(start, stop):
        return False
    corners = draft.faces[draft.faces_at_edge(start, stop)]
    across = corners[(corners != start) & (corners != stop)]
    if valence[across].max() >= MAX_VALENCE:
        return False
    middle = draft.vertices[[start, stop]].mean(axis=0)
    ends, tips = draft.vertices[[start, stop]], draft.vertices[across]
    halves = np.array([[end, middle, tip] for tip in tips for end in ends])
    return bool(measure_angles(halves).min() >= angle)


def _pull(draft: Draft, vertex: int, beside: Floats) -> bool:
    """Move a vertex so that the faces at it fit the samples beside them better.

    It takes most of the best step, or if that is not sound or no better, less.
    """
    if len(beside) == 0:
        return False
    still = move_vertex(draft, vertex, draft.vertices[vertex])
    directions, lack = draft.offsets(still, beside)
    normal = directions.T @ directions + 0.02 * len(lack) * np.eye(3)
    step = 0.7 * np.linalg.solve(normal, directions.T @ lack)
    needed = min(MIN_WANTED_ANGLE, float(draft.angles_before(still).min()))
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
    return float(np.mean(draft.measure_distances(edit, beside) ** 2))


def _take_best(draft: Draft, edits: list[Edit]) -> bool:
    """Make the edit that gains most, of those that are sound; of equally good ones, the first.

    It must win `MIN_ANGLE_GAIN` degrees; the `MAX_TRIED_EDITS` best ones are looked at.
    """
    gains = np.array([_gain(draft, edit) for edit in edits])
    for k in np.argsort(-gains.round(ANGLE_DECIMALS), kind="stable")[:MAX_TRIED_EDITS]:
        if gains[k] < MIN_ANGLE_GAIN:
            return False
        edit = settle(draft, edits[k]) if len(edits[k].added) != 2 else edits[k]
        if _gain(draft, edit) >= MIN_ANGLE_GAIN and draft.take(edit):
            return True
    return False


def _gain(draft: Draft, edit: Edit) -> float:
    """Return how much an edit raises the smallest angle where it is, up to the goal, degrees.

    The volume that it adds to the cage counts against it.
    """
    after = min(MIN_WANTED_ANGLE, float(draft.angles(edit).min()))
    gain = after - float(draft.angles_before(edit).min())
    if gain < MIN_ANGLE_GAIN:  # too little without the price
        return gain
    return gain - DEGREES_PER_GROWTH * max(0.0, draft.growth(edit)) / draft.volume


def _angle_edits(draft: Draft, face: Integers, fewest: int) -> Iterator[Edit]:
    """Return edits that may improve a face."""
    valence = draft.count_faces()
    corners = draft.vertices[face]
    lengths = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    for k in range(3):
        start, stop = int(face[k]), int(face[k - 2])
        flip = flip_edge(draft, start, stop)
        if flip is not None and _has_room(flip, valence):
            yield flip
        yield from _moves(draft, start)
    short = int(lengths.argmin())
    start, stop = int(face[short]), int(face[short - 2])
    if draft.count > fewest:
        for position in (draft.vertices[[start, stop]].mean(axis=0), draft.vertices[start]):
            merged = collapse_edge(draft, start, stop, position)
            if merged is not None and len(merged.added) <= MAX_VALENCE:
                yield merged


def _moves(draft: Draft, vertex: int) -> Iterator[Edit]:
    """Return moves of a vertex in eight directions of its tangent plane, and outward.

    They go up to half the mean length of its edges.
    """
    around = draft.faces_at(vertex)
    corners = draft.vertices[draft.faces[around]]
    normal = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    normal /= max(np.linalg.norm(normal), 1e-300)
    across = cross(normal, np.eye(3)[np.abs(normal).round(4).argmin()])  # the first of those alike
    across /= np.linalg.norm(across)
    along = cross(normal, across)
    here = draft.vertices[vertex]
    length = np.linalg.norm(draft.vertices[draft.neighbours(vertex)] - here, axis=1).mean()
    for step in (0.1, 0.25, 0.5):
        for turn in 2 * np.pi * np.arange(8) / 8:
            way = np.cos(turn) * across + np.sin(turn) * along
            yield move_vertex(draft, vertex, here + step * length * way)
        yield move_vertex(draft, vertex, here + step * length * normal)


def settle(draft: Draft, edit: Edit) -> Edit:
    """Move the edit's vertex as little as gives the samples near it their clearance, if it can.

    Every step solves the problem for the planes of the nearest faces. It goes a hundredth of the
    clearance further than needed: planes change as the vertex moves.
    """
    samples = draft.near_samples(edit)
    for _ in range(MAX_SETTLING_STEPS):
        directions, lack = draft.offsets(edit, samples)
        short = lack > 0
        if not short.any():
            break
        step = find_least_move(directions[short], lack[short] + 0.01 * draft.clearance)
        edit = Edit(edit.removed, edit.added, edit.vertex, edit.position + step)
        # What is far from all new faces stays so.
        samples = samples[lack > -3 * lack.max() - draft.clearance]
    return edit


def find_least_move(directions: Floats, lack: Floats) -> Floats:
    """Return the shortest x, (3,), with directions @ x ≥ lack; zero if there is none.

    Lawson and Hanson 1974, chapter 23: least distance programming, by its dual.
    """
    matrix = np.concatenate([directions.T, lack[None]])
    target = np.array([0.0, 0, 0, 1])
    dual, _ = nnls(matrix, target)
    residual = matrix @ dual - target
    if not abs(residual[3]) > 1e-9:
        return np.zeros(3)
    return np.asarray(-residual[:3] / residual[3])
