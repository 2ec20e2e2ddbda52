"""Take vertices from where a cage does not need them to where its error is."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.cages.building.carry import Poses
from cageik_cli.cages.building.draft import Draft
from cageik_cli.cages.building.edits import collapse_edge, settle
from cageik_cli.cages.building.judge import Demand
from cageik_cli.cages.building.polish import (
    LARGEST_VALENCE,
    lower_valences,
    mend_angles,
    splits_well,
    tighten,
)
from cageik_cli.cages.building.quadrics import collapse_costs, vertex_quadrics
from cageik_cli.cages.building.refine import AIM, complete_clearance
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import closest_points
from cageik_cli.util.arrays import Floats

SMALLEST_ANGLE = 10.0
"""Degrees that new faces keep, unless the old ones had less."""


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """The errors of a cage on an animation.

    Attributes
    ----------
    points : (m, 3) float64
        The model's vertices, units of the model.
    squares : (m,) float64
        Mean squares over the frames of how far each is missed, in any unit.
    """

    points: Floats
    squares: Floats


def shift_vertices(
    cage: TriMesh, demand: Demand, poses: Poses, residuals: Residuals, count: int
) -> TriMesh:
    """Collapse `count` edges that matter least in the poses, and split as many that miss most."""
    cage, samples = complete_clearance(cage, demand, demand.samples, rounds=2)
    draft = Draft(cage, samples, AIM * demand.clearance)
    _collapse_idle(draft, poses, residuals, draft.count - count)
    while draft.count < demand.most and _split_worst(draft, residuals):
        pass
    for _ in range(2):
        tighten(draft, samples)
        mend_angles(draft, draft.count)
    lower_valences(draft)
    return complete_clearance(draft.to_mesh(), demand, samples, rounds=6)[0]


def _collapse_idle(draft: Draft, poses: Poses, residuals: Residuals, count: int) -> None:
    """Collapse edges down to `count` vertices, those first that bend least and are missed least."""
    while draft.count > count:
        mesh = TriMesh(draft.vertices, draft.faces)
        ends = mesh.edges.ends
        cost, places = collapse_costs(vertex_quadrics(mesh), draft.vertices, ends)
        for posed in poses.carry(draft.vertices):
            cost += collapse_costs(vertex_quadrics(TriMesh(posed, draft.faces)), posed, ends)[0]
        missed = np.zeros(len(draft.vertices))
        for k in range(3):
            np.add.at(missed, draft.faces[:, k], _missed(draft, residuals))
        cost *= 1 + missed[ends].sum(axis=1) / missed.mean()
        for edge in np.argsort(cost, kind="stable"):
            if _try_collapse(draft, int(ends[edge, 0]), int(ends[edge, 1]), places[edge]):
                break
        else:
            return


def _split_worst(draft: Draft, residuals: Residuals) -> bool:
    """Split the edge whose faces miss most; return whether there was one."""
    edges = TriMesh(draft.vertices, draft.faces).edges
    missed = _missed(draft, residuals)
    score = np.zeros(len(edges.ends))
    for side in range(3):
        np.add.at(score, edges.side_edges[:, side], missed)
    length = np.linalg.norm(np.diff(draft.vertices[edges.ends], axis=1)[:, 0], axis=1)
    valence = np.bincount(draft.faces.ravel(), minlength=len(draft.vertices))
    for edge in np.argsort(-score * length, kind="stable"):
        start, stop = map(int, edges.ends[edge])
        if splits_well(draft, start, stop, valence, SMALLEST_ANGLE):
            draft.split(start, stop)
            return True
    return False


def _missed(draft: Draft, residuals: Residuals) -> Floats:
    """Return the sum of the squares of the points nearest to each face, (f,)."""
    face = closest_points(TriMesh(draft.vertices, draft.faces), residuals.points).face
    sums = np.bincount(face, weights=residuals.squares, minlength=len(draft.faces))
    return np.asarray(sums, np.float64)


def _try_collapse(draft: Draft, start: int, stop: int, position: Floats) -> bool:
    """Collapse an edge if the cage stays sound and in shape."""
    edit = collapse_edge(draft, start, stop, position)
    if edit is None or len(edit.added) > LARGEST_VALENCE:
        return False
    needed = min(SMALLEST_ANGLE, float(draft.angles_before(edit).min()))
    edit = settle(draft, edit)
    return bool(draft.angles(edit).min() >= needed) and draft.take(edit)
