"""The edits of a cage: move a vertex, flip an edge, collapse an edge."""

import numpy as np
from scipy.optimize import nnls

from cageik_cli.cages.building.draft import Draft, Edit
from cageik_cli.util.arrays import Floats

SETTLING = 5
"""Steps in which a moved vertex looks for a place that keeps off the samples."""

AHEAD = 0.01
"""How much further than needed it goes, in clearances: planes change as it moves."""


def move_vertex(draft: Draft, vertex: int, position: Floats) -> Edit:
    """Move a vertex."""
    around = draft.faces_at(vertex)
    return Edit(around, draft.faces[around], vertex, position)


def flip_edge(draft: Draft, start: int, stop: int) -> Edit | None:
    """Put the other diagonal in the place of an edge; None if that is an edge already."""
    at = draft.faces_at(start)
    beside = at[(draft.faces[at] == stop).any(axis=1)]
    if len(beside) != 2:
        return None
    across = [_opposite(draft.faces[face], start, stop) for face in beside]
    if across[0] == across[1] or across[1] in draft.neighbours(across[0]):
        return None
    # The first face has the edge forward or backward; its orientation is handed on.
    face = draft.faces[beside[0]].tolist()
    forward = face[(face.index(start) + 1) % 3] == stop
    a, b = (start, stop) if forward else (stop, start)
    added = np.array([[across[0], a, across[1]], [across[1], b, across[0]]])
    return Edit(beside, added, start, draft.vertices[start])


def collapse_edge(draft: Draft, start: int, stop: int, position: Floats) -> Edit | None:
    """Merge the end of an edge into its start; None if the surface would not stay manifold."""
    common = np.intersect1d(draft.neighbours(start), draft.neighbours(stop))
    if len(common) != 2 or len(draft.faces) <= 4:
        return None
    if min(len(draft.faces_at(vertex)) for vertex in common) <= 3:
        return None
    removed = np.union1d(draft.faces_at(start), draft.faces_at(stop))
    added = np.where(draft.faces[removed] == stop, start, draft.faces[removed])
    added = added[(added == start).sum(axis=1) == 1]
    return Edit(removed, added, start, position)


def settle(draft: Draft, edit: Edit) -> Edit:
    """Move the edit's vertex as little as gives the samples near it their clearance, if it can.

    Every step solves the problem for the planes of the nearest faces.
    """
    samples = draft.near_samples(edit)
    for _ in range(SETTLING):
        directions, lack = draft.offsets(edit, samples)
        short = lack > 0
        if not short.any():
            break
        step = least_move(directions[short], lack[short] + AHEAD * draft.clearance)
        edit = Edit(edit.removed, edit.added, edit.vertex, edit.position + step)
    return edit


def least_move(directions: Floats, lack: Floats) -> Floats:
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


def _opposite(face: Floats, start: int, stop: int) -> int:
    """Return the corner of a face that is not on an edge of it."""
    return int(face[(face != start) & (face != stop)][0])
