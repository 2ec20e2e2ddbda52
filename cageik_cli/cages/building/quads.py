"""From the triangles of a cage to quads, whichever diagonal cuts which, around the model.

Triangles are paired, their vertices moved so that quads are flat, and both triangles of every quad
pushed off the model, by either diagonal. A quad whose other diagonal would touch is left as two
triangles.
"""

import numpy as np
from scipy import sparse
from scipy.optimize import Bounds, LinearConstraint, milp

from cageik_cli.cages.building.draft import Draft, Edit, keep_apart
from cageik_cli.cages.building.judge import Demand, find_near_points, judge, keep_one_per_cell
from cageik_cli.cages.building.polish import tighten
from cageik_cli.cages.building.refine import find_contacts
from cageik_cli.cages.push import Contacts, push
from cageik_cli.cages.quality import MIN_SHEET_RATIO
from cageik_cli.geometry.intersections import crossing_face_pairs, self_intersections
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import corner_angles, cross, measure_angles, thin_face_pairs
from cageik_cli.geometry.surface import closest_points, winding_numbers
from cageik_cli.geometry.surface_attributes import SurfaceAttributes
from cageik_cli.util.arrays import Floats, Integers, Mask

MIN_QUAD_SHARE = 0.7
"""A smaller share of quads among the faces of a cage is noted."""

MIN_QUAD_ANGLE = 8.0
"""Degrees that the triangles of a quad have, by either diagonal."""

MIN_QUAD_COSINE = 0.3
"""Between the normals of two triangles that are paired, at least: a sharp edge stays."""

PLANAR_ROUNDS = 4
"""Rounds in which the corners of quads are moved towards their planes."""

MAX_CLEARED = 5
"""Rounds of pushes, each with the points that were too near after the last one."""

HALVES = ((0, 1, 2), (0, 2, 3), (1, 2, 3), (1, 3, 0))
"""Corners of the triangles of a quad by one diagonal, and by the other."""


def pair_triangles(cage: TriMesh) -> Integers:
    """Pair triangles into quads, as many and as well shaped ones as can be: (q, 4) corners.

    The diagonal that the cage has is from the first corner to the third. This is the matching of
    greatest weight in the graph of triangles that share an edge, by an integer program; vertices
    keep three edges.
    """
    quads, pairs = _list_quads(cage)
    scores = _score_quads(cage.vertices, quads)
    is_edge = np.isin(_name_pairs(quads[:, [1, 3]]), _name_pairs(cage.edges.ends))
    usable = np.flatnonzero((scores > 0) & ~is_edge)
    if len(usable) == 0:
        return np.empty((0, 4), np.int64)
    valence = np.bincount(cage.faces.ravel(), minlength=len(cage.vertices))
    found = milp(
        -(0.5 + scores[usable]),
        integrality=np.ones(len(usable)),
        bounds=Bounds(0, 1),
        constraints=[
            LinearConstraint(_count_uses(pairs[usable], len(cage.faces)), ub=1),
            LinearConstraint(_count_uses(quads[usable][:, [0, 2]], len(valence)), ub=valence - 3),
        ],
    )
    chosen = quads[usable[found.x > 0.5]]
    # No edge may be the other diagonal of two quads.
    return np.asarray(chosen[np.unique(_name_pairs(chosen[:, [1, 3]]), return_index=True)[1]])


def _name_pairs(ends: Integers) -> Integers:
    """Return one number for each pair of vertices, (k, 2), in whatever order."""
    return np.asarray(ends.min(axis=1) << 32 | ends.max(axis=1))


def _count_uses(pairs: Integers, count: int) -> sparse.csr_array:
    """Return the matrix that counts how often each of `count` things is in chosen pairs."""
    columns = np.repeat(np.arange(len(pairs)), 2)
    shape = (count, len(pairs))
    return sparse.csr_array((np.ones(2 * len(pairs)), (pairs.ravel(), columns)), shape=shape)


def _list_quads(cage: TriMesh) -> tuple[Integers, Integers]:
    """Return the quad around each edge, (e, 4), from one end of the edge; its faces, (e, 2)."""
    edges = cage.edges
    order = np.argsort(edges.side_edges.ravel(), kind="stable").reshape(-1, 2)
    face, side = np.divmod(order, 3)
    first, second = face.T
    tip = cage.faces[first, side[:, 0]]
    start, stop = cage.faces[first, (side[:, 0] + 1) % 3], cage.faces[first, (side[:, 0] + 2) % 3]
    other = cage.faces[second, side[:, 1]]
    return np.stack([start, other, stop, tip], axis=1), face


def _score_quads(vertices: Floats, quads: Integers) -> Floats:
    """Return how good quads are, (q,), 0 to 1; 0 for those that may not be."""
    corners = vertices[quads]
    angles = np.stack([measure_angles(corners[:, list(c)]).min(axis=1) for c in HALVES])
    normals = np.stack([cross(*_sides(corners[:, list(c)])) for c in HALVES])
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-300)
    whole = normals[0] + normals[1]
    is_convex = ((normals * whole).sum(axis=2) > 0.1).all(axis=0)
    cosine = (normals[0] * normals[1]).sum(axis=1)
    usable = is_convex & (cosine > MIN_QUAD_COSINE) & (angles.min(axis=0) > MIN_QUAD_ANGLE)
    ahead = np.roll(corners, -1, axis=1) - corners
    back = np.roll(corners, 1, axis=1) - corners
    turn = (ahead * back).sum(axis=2)
    turn /= np.linalg.norm(ahead, axis=2) * np.linalg.norm(back, axis=2)
    squareness = 1 - np.abs(turn).max(axis=1)
    return np.where(usable, squareness * np.maximum(cosine, 0), 0.0)


def _sides(corners: Floats) -> tuple[Floats, Floats]:
    return corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]


def make_quads(cage: TriMesh, demand: Demand) -> TriMesh:
    """Return a cage with quads in place of most pairs of triangles, in the units of the demand.

    Its triangles are those of one diagonal of each quad; with the other ones it passes the same
    tests. A cage of which no quad passes is returned as it is.
    """
    quads, samples = pair_triangles(cage), demand.samples
    angle = min(MIN_QUAD_ANGLE, float(corner_angles(cage).min()))
    while len(quads):
        moved, samples = _clear_quads(_flatten(cage, quads), quads, demand, samples)
        moved = _tighten(moved, quads, demand, samples)
        moved, samples = _clear_quads(moved, quads, demand, samples)
        failing = _find_failing(moved, quads, demand, angle)
        if not failing.any():
            return _join(moved, quads)
        quads = quads[~failing]
    return cage


def describe_few_quads(cage: TriMesh) -> tuple[str, ...]:
    """Return a note if few of the faces are quads, or none."""
    share = float((cage.polygons.corner_counts == 4).mean())
    if share >= MIN_QUAD_SHARE:
        return ()
    return (
        f"{100 * share:.0f} % of the faces are quads, expected {100 * MIN_QUAD_SHARE:g} % or more; "
        "the others are at sharp edges, or would not hold the model by either diagonal",
    )


def _turn_diagonals(cage: TriMesh, quads: Integers) -> TriMesh:
    """Return the cage with the other diagonal in each quad; their faces are the last ones."""
    kept = ~_mark_faces(cage.faces, quads)
    turned = quads[:, HALVES[2:]].reshape(-1, 3)
    return TriMesh(cage.vertices, np.concatenate([cage.faces[kept], turned]))


def _mark_faces(faces: Integers, quads: Integers) -> Mask:
    """Return which faces are halves of a quad by the cage's own diagonals."""
    halves = quads[:, HALVES[:2]].reshape(-1, 3).tolist()
    return _are_in(faces, {tuple(sorted(half)) for half in halves})


def _join(cage: TriMesh, quads: Integers) -> TriMesh:
    """Return the cage with its quads first, cut by the diagonals that it has, then triangles."""
    kept = cage.faces[~_mark_faces(cage.faces, quads)]
    faces = np.concatenate([quads[:, HALVES[:2]].reshape(-1, 3), kept])
    counts = np.repeat([4, 3], [len(quads), len(kept)])
    corners = np.concatenate([quads.ravel(), kept.ravel()])
    return TriMesh(cage.vertices, faces, SurfaceAttributes(counts, corners))


def _clear_quads(
    cage: TriMesh, quads: Integers, demand: Demand, samples: Floats
) -> tuple[TriMesh, Floats]:
    """Push both cuts off the samples, and off what is too near beside them."""
    for _ in range(MAX_CLEARED):
        cage = _push_cuts(cage, quads, samples, demand.clearance)
        near = [
            find_near_points(demand.surface, cut, 1.01 * demand.clearance)[1]
            for cut in (cage, _turn_diagonals(cage, quads))
        ]
        if not sum(map(len, near)):
            break
        added = keep_one_per_cell(np.concatenate(near), 0.5 * demand.clearance)
        samples = np.concatenate([samples, added])
    return cage, samples


def _flatten(cage: TriMesh, quads: Integers) -> TriMesh:
    """Move the corners of quads towards the planes through their middles."""
    vertices, count = cage.vertices, np.bincount(quads.ravel(), minlength=len(cage.vertices))
    for _ in range(PLANAR_ROUNDS):
        corners = vertices[quads]
        normal = cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        height = ((corners - corners.mean(axis=1, keepdims=True)) * normal[:, None]).sum(axis=2)
        moves = np.zeros_like(vertices)
        np.add.at(moves, quads, -height[:, :, None] * normal[:, None])
        vertices = vertices + moves / np.maximum(count, 1)[:, None]
    return TriMesh(vertices, cage.faces)


def _push_cuts(cage: TriMesh, quads: Integers, samples: Floats, clearance: float) -> TriMesh:
    """Push a cage off samples, with its own diagonals and with the others at once."""

    def find(moved: TriMesh, _: float) -> Contacts:
        both = [
            find_contacts(cut, samples, 1.03 * clearance)[0]
            for cut in (moved, _turn_diagonals(moved, quads))
        ]
        names = ("corners", "weights", "direction", "missing")
        return Contacts(*(np.concatenate([getattr(c, name) for c in both]) for name in names))

    return push(cage, find, smoothness=0.05, stiffness=0.005, enough=(1.03 - 1.015) * clearance)


class QuadDraft(Draft):
    """A draft that holds the triangles of both diagonals of its quads: each cut stays sound."""

    def __init__(self, cuts: tuple[TriMesh, TriMesh], samples: Floats, clearance: float) -> None:
        self._cuts = [{tuple(sorted(face)) for face in cut.faces.tolist()} for cut in cuts]
        first, second = (cut.faces for cut in cuts)
        faces = np.concatenate([first, second[~_are_in(second, self._cuts[0])]])
        super().__init__(TriMesh(cuts[0].vertices, faces), samples, clearance)

    def _stays_apart(self, edit: Edit) -> bool:
        """Return whether the new faces of each cut meet no other of the same cut improperly."""
        vertices = self.vertices.copy()
        vertices[edit.vertex] = edit.position
        rest = np.delete(self.faces, edit.removed, axis=0)
        return all(
            keep_apart(vertices, edit.added[_are_in(edit.added, cut)], rest[_are_in(rest, cut)])
            for cut in self._cuts
        )


def _are_in(faces: Integers, cut: set[tuple[int, ...]]) -> Mask:
    """Return which faces a cut has, (f,)."""
    return np.array([tuple(sorted(face)) in cut for face in faces.tolist()], bool)


def _tighten(cage: TriMesh, quads: Integers, demand: Demand, samples: Floats) -> TriMesh:
    """Pull the vertices towards the model, as far as both cuts allow."""
    cuts = cage, _turn_diagonals(cage, quads)
    draft = QuadDraft(cuts, samples, 1.01 * demand.clearance)
    tighten(draft, samples)
    return TriMesh(draft.vertices, cage.faces)


def _find_failing(cage: TriMesh, quads: Integers, demand: Demand, angle: float) -> Mask:
    """Return which quads are at fault, (q,), where the cage fails with either diagonal.

    It fails, too, if a triangle has a smaller angle than this, degrees.
    """
    failing = np.zeros(len(quads), bool)
    turned = _turn_diagonals(cage, quads)
    fixed = len(cage.faces) - 2 * len(quads)
    for cut in (_join(cage, quads), turned):
        verdict = judge(TriMesh(cut.vertices, cut.faces), demand)
        if verdict.is_valid and verdict.smallest_angle >= angle:
            continue
        bad = _find_bad_faces(cut, demand, angle)
        of_quad = (bad - fixed) // 2 if cut is turned else bad // 2
        of_quad = of_quad[(of_quad >= 0) & (of_quad < len(quads))]
        if len(of_quad) == 0:  # what is at fault is beside quads
            of_quad = np.flatnonzero(np.isin(quads, cut.faces[bad]).any(axis=1))
        if len(of_quad) == 0:
            return np.ones(len(quads), bool)
        failing[of_quad] = True
    return failing


def _find_bad_faces(cage: TriMesh, demand: Demand, angle: float) -> Integers:
    """Return the faces that cross others, are needles, or are too near to the model or in it."""
    crossing = self_intersections(cage)
    _, near = find_near_points(demand.surface, cage, demand.clearance)
    outside = demand.samples[winding_numbers(cage, demand.samples) < 0.5]
    points = np.concatenate([near, outside])
    nearest = closest_points(cage, points).face if len(points) else np.empty(0, np.int64)
    crossed = crossing_face_pairs(demand.surface, cage, 0.0)[:, 1]
    needles = np.flatnonzero(corner_angles(cage).min(axis=1) < angle)
    sheets, _ = thin_face_pairs(cage, MIN_SHEET_RATIO)
    return np.unique(np.concatenate([crossing.ravel(), nearest, crossed, needles, sheets.ravel()]))
