"""A cage with quads as triangles: cut by one diagonal of each quad, by the other, or by both.

Quads are (q, 4) corners; the diagonal that the cage has is from the first corner to the third.
"""

import numpy as np

from cageik_cli.cages.building.contacts import find_contacts
from cageik_cli.cages.building.judge import Demand, find_near_points, judge
from cageik_cli.cages.building.pairing import HALVES
from cageik_cli.cages.push import Contacts, make_form, push, solve_moves
from cageik_cli.cages.quality import MIN_SHEET_RATIO
from cageik_cli.geometry.intersections import crossing_face_pairs, self_intersections
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import corner_angles, thin_face_pairs
from cageik_cli.geometry.surface import closest_points, winding_numbers
from cageik_cli.geometry.surface_attributes import SurfaceAttributes
from cageik_cli.util.arrays import Floats, Integers, Mask

FITTING_STEPS = 4
"""Least-squares steps in which cuts are fitted to a model."""

PULL_WEIGHT = 0.1
"""What a sample counts for that is further from a cut than wanted, over one that is nearer."""

MAX_PULLED = 1.0
"""Samples further from a cut than this do not pull, in diagonals: none is."""


def join_quads(cage: TriMesh, quads: Integers) -> TriMesh:
    """Return the cage with its quads first, cut by the diagonals that it has, then triangles."""
    kept = _find_triangles(cage.faces, quads)
    faces = np.concatenate([quads[:, HALVES[:2]].reshape(-1, 3), kept])
    counts = np.repeat([4, 3], [len(quads), len(kept)])
    corners = np.concatenate([quads.ravel(), kept.ravel()])
    return TriMesh(cage.vertices, faces, SurfaceAttributes(counts, corners))


def turn_diagonals(cage: TriMesh, quads: Integers) -> TriMesh:
    """Return the cage with the other diagonal in each quad; the faces of quads are the first."""
    turned = quads[:, HALVES[2:]].reshape(-1, 3)
    return TriMesh(cage.vertices, np.concatenate([turned, _find_triangles(cage.faces, quads)]))


def _find_triangles(faces: Integers, quads: Integers) -> Integers:
    """Return the faces that are no halves of a quad."""
    halves = {tuple(half) for half in np.sort(quads[:, HALVES[:2]].reshape(-1, 3)).tolist()}
    alone = [tuple(face) not in halves for face in np.sort(faces).tolist()]
    return np.asarray(faces[np.array(alone, bool)])


def push_cuts(cage: TriMesh, quads: Integers, samples: Floats, clearance: float) -> TriMesh:
    """Push a cage off samples, with its own diagonals and with the others at once."""
    return push(
        cage,
        lambda moved, _: _find_all_contacts(moved, quads, samples, 1.03 * clearance),
        smoothness=0.05,
        stiffness=0.005,
        enough=(1.03 - 1.015) * clearance,
    )


def fit_cuts(cage: TriMesh, quads: Integers, demand: Demand) -> TriMesh:
    """Move a cage to where both cuts are at the clearance from the samples, in least squares."""
    form = make_form(cage, smoothness=0.3, stiffness=0.03)
    for _ in range(FITTING_STEPS):
        found = _find_all_contacts(cage, quads, demand.samples, MAX_PULLED)
        missing = found.missing - MAX_PULLED + demand.clearance
        contacts = Contacts(found.corners, found.weights, found.direction, missing)
        moves = solve_moves(contacts, np.where(missing > 0, 1, PULL_WEIGHT), form)
        cage = TriMesh(cage.vertices + moves, cage.faces)
    return cage


def _find_all_contacts(
    cage: TriMesh, quads: Integers, samples: Floats, clearance: float
) -> Contacts:
    """Return the samples with less than the clearance from either cut."""
    both = [
        find_contacts(cut, samples, clearance)[0] for cut in (cage, turn_diagonals(cage, quads))
    ]
    names = ("corners", "weights", "direction", "missing")
    return Contacts(*(np.concatenate([getattr(found, name) for found in both]) for name in names))


def find_near_cuts(cage: TriMesh, quads: Integers, demand: Demand) -> Floats:
    """Return points of the model that are nearer to a cut than a little more than allowed."""
    cuts = cage, turn_diagonals(cage, quads)
    limit = 1.01 * demand.clearance
    return np.concatenate([find_near_points(demand.surface, cut, limit)[1] for cut in cuts])


def find_near_quads(cage: TriMesh, quads: Integers, demand: Demand) -> Mask:
    """Return which quads are nearer to the model than allowed by their other diagonals, (q,)."""
    halves = TriMesh(cage.vertices, quads[:, HALVES[2:]].reshape(-1, 3)).drop_unused_vertices()
    near = _find_nearest_faces(
        halves, find_near_points(demand.surface, halves, demand.clearance)[1]
    )
    return np.isin(np.arange(len(quads)), near // 2)


def find_failing(cage: TriMesh, quads: Integers, demand: Demand, angle: float) -> Mask:
    """Return which quads are at fault, (q,), where the cage fails with any choice of diagonals.

    It fails, too, if a triangle has a smaller angle than this, degrees.
    """
    failing = np.zeros(len(quads), bool)
    for cut in (join_quads(cage, quads), turn_diagonals(cage, quads)):
        verdict = judge(TriMesh(cut.vertices, cut.faces), demand)
        if verdict.is_valid and verdict.smallest_angle >= angle:
            continue
        bad = _find_bad_faces(cut, demand, angle)
        of_quad = bad[bad < 2 * len(quads)] // 2
        if len(of_quad) == 0:  # what is at fault is beside quads
            of_quad = np.flatnonzero(np.isin(quads, cut.faces[bad]).any(axis=1))
        if len(of_quad) == 0:
            return np.ones(len(quads), bool)
        failing[of_quad] = True
    failing[_find_crossing(cage, quads)] = True
    return failing


def _find_bad_faces(cage: TriMesh, demand: Demand, angle: float) -> Integers:
    """Return the faces that cross others, are needles, or are too near to the model or in it."""
    crossing = self_intersections(cage)
    _, near = find_near_points(demand.surface, cage, demand.clearance)
    outside = demand.samples[winding_numbers(cage, demand.samples) < 0.5]
    nearest = _find_nearest_faces(cage, np.concatenate([near, outside]))
    crossed = crossing_face_pairs(demand.surface, cage, 0.0)[:, 1]
    needles = np.flatnonzero(corner_angles(cage).min(axis=1) < angle)
    sheets, _ = thin_face_pairs(cage, MIN_SHEET_RATIO)
    return np.unique(np.concatenate([crossing.ravel(), nearest, crossed, needles, sheets.ravel()]))


def _find_crossing(cage: TriMesh, quads: Integers) -> Integers:
    """Return the quads whose halves, by either diagonal, cross other faces by either diagonal."""
    own, turned = join_quads(cage, quads).faces, turn_diagonals(cage, quads).faces
    count = 2 * len(quads)
    pairs = self_intersections(TriMesh(cage.vertices, np.concatenate([own, turned[:count]])))
    owner = np.full(len(own) + count, -1)
    owner[:count] = owner[len(own) :] = np.repeat(np.arange(len(quads)), 2)
    one, other = owner[pairs].T
    found = np.unique(np.concatenate([one, other])[np.tile(one != other, 2)])
    return np.asarray(found[found >= 0])


def _find_nearest_faces(cage: TriMesh, points: Floats) -> Integers:
    if len(points) == 0:
        return np.empty(0, np.int64)
    return np.asarray(closest_points(cage, points).face)
