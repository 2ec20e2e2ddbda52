"""From the triangles of a cage to quads, whichever diagonal cuts which, around the model.

Triangles are paired, and vertices moved to where the quads hold the model by either diagonal, as
far as the cage stays sound. The quads that hold it then are kept, and pairs are chosen again
without those that do not.

The cage is triangles throughout: quads are (q, 4) corners, cut by one diagonal, from the first
corner to the third, which the cage has, or by the other, or by both.
"""

import numpy as np

from cageik_cli.cages.builder.contacts import find_contacts
from cageik_cli.cages.builder.draft import Draft, Edit
from cageik_cli.cages.builder.judge import Demand, find_near_points, judge, keep_one_per_cell
from cageik_cli.cages.builder.loops import NO_LOOPS, Loops
from cageik_cli.cages.builder.paired import PairedDraft
from cageik_cli.cages.builder.pairing import HALVES, MIN_QUAD_ANGLE, Pairing, name_diagonals
from cageik_cli.cages.builder.polish import flip_edge, move_vertex, settle, tighten
from cageik_cli.cages.builder.refine import make_draft
from cageik_cli.cages.builder.symmetry import average_sides, find_partners, reflect
from cageik_cli.cages.check.quality import MIN_SHEET_RATIO
from cageik_cli.cages.push import Contacts, make_form, push, solve_moves
from cageik_cli.geometry.attributes import SurfaceAttributes
from cageik_cli.geometry.intersections import crossing_face_pairs, self_intersections
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import corner_angles, thin_face_pairs
from cageik_cli.geometry.surface import closest_points, winding_numbers
from cageik_cli.util.arrays import Floats, Integers, Mask

MIN_QUAD_SHARE = 0.7
"""A smaller share of quads among the faces of a cage is noted."""

MAX_PAIRINGS = 5
"""How often triangles are paired, each time without the pairs that failed before."""

MAX_CLEARED = 5
"""Rounds of pushes, each with the points that were too near after the last one."""

PAIRED_COSINES = (0.3, 0.3, 0.1)
"""Between the normals of triangles that are paired, at least, in each round of pairing and fitting;
the last one is for cages that have few quads after the others."""

FITTING_STEPS = 4
"""Least-squares steps in which cuts are fitted to a model."""

PULL_WEIGHT = 0.1
"""What a sample counts for that is further from a cut than wanted, over one that is nearer."""

MAX_PULLED = 1.0
"""Samples further from a cut than this do not pull, in diagonals: none is."""

WALKS = 3
"""How often each vertex is moved towards its place: others may have been in its way."""


def make_quads(cage: TriMesh, demand: Demand, loops: Loops = NO_LOOPS) -> TriMesh:
    """Return a cage with quads in place of most pairs of triangles, in the units of the demand.

    Edges of loops stay edges.

    Its triangles are those of one diagonal of each quad; with any other ones it passes the same
    tests. A cage of which no quad passes is returned as it is.
    """
    return _Maker(cage, demand, loops).run()


def describe_few_quads(cage: TriMesh) -> tuple[str, ...]:
    """Return a note if few of the faces are quads, or none."""
    share = float((cage.polygons.corner_counts == 4).mean())
    if share >= MIN_QUAD_SHARE:
        return ()
    return (
        f"{100 * share:.0f} % of the faces are quads, expected {100 * MIN_QUAD_SHARE:g} % or more; "
        "the others are at sharp edges, or would not hold the model by either diagonal",
    )


class QuadDraft(Draft):
    """A draft of a cage whose faces are triangles, and halves of quads by both diagonals.

    Vertices move, and pairs of triangles become quads; a half of one quad may not cross that of
    another.
    """

    def __init__(self, cage: TriMesh, samples: Floats, clearance: float) -> None:
        super().__init__(cage, samples, clearance)
        self._cut = np.zeros(len(cage.faces), np.int64)  # of halves, 1 or 2: by which diagonal

    def add(self, quad: Integers) -> None:
        """Make two triangles a quad, untested; its first diagonal is the edge between them."""
        self._cut[self.faces_at_edge(int(quad[0]), int(quad[2]))] = 1
        self.faces = np.concatenate([self.faces, quad[list(HALVES[2:])]])
        self._cut = np.append(self._cut, [2, 2])

    def hold(self, quad: Integers, angle: float) -> bool:
        """Make two triangles a quad if its other halves are sound; return whether they are.

        Their angles must be at least this, degrees.
        """
        halves = self.faces_at_edge(int(quad[0]), int(quad[2]))
        edit = Edit(halves, quad[list(HALVES[2:])], int(quad[0]), self.vertices[quad[0]])
        if self.angles(edit).min() < angle or not self.allows(edit):
            return False
        self.add(quad)
        return True

    def walk(self, places: Floats, angle: float) -> None:
        """Move vertices towards places, (n, 3), as far as the cage stays sound.

        Angles do not become smaller than this, degrees, or than they are.
        """
        for _ in range(WALKS):
            for vertex in np.flatnonzero((self.vertices != places).any(axis=1)).tolist():
                self._step(vertex, places[vertex], angle)

    def apply(self, edit: Edit) -> None:
        """Move a vertex, untested; the faces stay in their order."""
        self.vertices[edit.vertex] = edit.position

    def _step(self, vertex: int, place: Floats, angle: float) -> None:
        """Move a vertex to a place, or half of the way."""
        here = self.vertices[vertex].copy()
        for share in (1.0, 0.5):
            edit = move_vertex(self, vertex, here + share * (place - here))
            if self._take_in_shape(edit, angle) or self._take_in_shape(settle(self, edit), angle):
                return

    def _take_in_shape(self, edit: Edit, angle: float) -> bool:
        needed = min(angle, float(self.angles_before(edit).min()))
        return bool(self.angles(edit).min() >= needed) and self.take(edit)

    def _find_swept(self, edit: Edit, samples: Floats) -> Mask:
        """Return the samples that an edit sweeps over, by the one diagonals or by the others."""
        if not np.array_equal(edit.added, self.faces[edit.removed]):
            return super()._find_swept(edit, samples)
        swept = np.zeros(len(samples), bool)
        for other in (1, 2):
            of_cut = self._cut[edit.removed] != other
            moved = Edit(edit.removed[of_cut], edit.added[of_cut], edit.vertex, edit.position)
            swept |= super()._find_swept(moved, samples)
        return swept


class _Maker:
    """A cage, and those of its quads that hold the model by either diagonal."""

    def __init__(self, cage: TriMesh, demand: Demand, loops: Loops) -> None:
        self._loops = loops
        self._cage, self._demand, self._samples = cage, demand, demand.samples
        self._angle = min(MIN_QUAD_ANGLE, float(corner_angles(cage).min()))
        self._partners = None if demand.axis is None else find_partners(cage.vertices, demand.axis)
        self._quads = np.empty((0, 4), np.int64)

    def run(self) -> TriMesh:
        """Make quads of triangles."""
        before = self._cage
        self._flip_edges()
        for cosine in PAIRED_COSINES[:-1]:
            self._pair_triangles(cosine)
        if len(self._quads) / (len(self._cage.faces) - len(self._quads)) < MIN_QUAD_SHARE:
            self._pair_triangles(PAIRED_COSINES[-1])
        draft = self._make_draft(1.01 * self._demand.clearance)
        tighten(draft, self._samples)
        self._cage = TriMesh(draft.vertices, self._cage.faces)
        while len(self._quads):
            self._cage = self._clear(self._cage, self._quads)
            failing = find_failing(self._cage, self._quads, self._demand, self._angle)
            if not failing.any():
                break
            self._quads = self._keep_pairs(self._quads[~failing])
        return join_quads(self._cage, self._quads) if len(self._quads) else before

    def _flip_edges(self) -> None:
        """Flip the edges that keep triangles from finding a partner."""
        draft = make_draft(self._cage, self._demand, self._samples, self._loops)
        refused = set(self._loops.edges)
        for _ in range(MAX_PAIRINGS):
            before = len(refused)
            pairing = Pairing(self._cage, PAIRED_COSINES[0], self._partners)
            for edge in pairing.choose_flips(refused):
                flip = flip_edge(draft, *edge)
                if flip is None or draft.angles(flip).min() < self._angle or not draft.take(flip):
                    refused.add(edge)
            self._cage = TriMesh(draft.vertices, draft.faces)
            if len(refused) == before:
                break

    def _pair_triangles(self, cosine: float) -> None:
        """Pair triangles, keep the quads that hold the model, and fit the cage to it."""
        failed = set(self._loops.edges)
        for _ in range(MAX_PAIRINGS):
            held = set(name_diagonals(self._quads))
            quads = Pairing(self._cage, cosine, self._partners).choose(failed, held)
            is_held = np.array([edge in held for edge in name_diagonals(quads)], bool)
            if is_held.all():
                break
            self._quads, added = quads[is_held], quads[~is_held]
            # Push the cage until it holds the model with these quads, too, and keep those that do.
            self._walk(self._cage, np.concatenate([self._quads, added]), self._demand.clearance)
            added = added[~find_near_quads(self._cage, added, self._demand)]
            draft = self._make_draft(self._demand.clearance)
            added = added[[draft.hold(quad, self._angle) for quad in added]]
            self._quads = self._keep_pairs(np.concatenate([self._quads, added]))
            failed |= set(name_diagonals(quads)) - set(name_diagonals(self._quads))
        # Pushed off the model for quads that failed, too, it is far away; flatter, it pairs better.
        fitted = self._average(fit_cuts(self._cage, self._quads, self._demand))
        self._walk(fitted, self._quads, 1.01 * self._demand.clearance)

    def _walk(self, target: TriMesh, quads: Integers, clearance: float) -> None:
        """Move the cage towards a target that is pushed off the model, as far as it stays sound."""
        places = self._clear(target, quads).vertices
        draft = self._make_draft(clearance)
        draft.walk(places, self._angle)
        self._cage = TriMesh(draft.vertices, self._cage.faces)

    def _clear(self, cage: TriMesh, quads: Integers) -> TriMesh:
        """Push both cuts off the samples, and off what is too near beside them."""
        axis, clearance = self._demand.axis, self._demand.clearance
        for _ in range(MAX_CLEARED):
            cage = self._average(push_cuts(cage, quads, self._samples, clearance))
            near = find_near_cuts(cage, quads, self._demand)
            if len(near) == 0:
                break
            near = keep_one_per_cell(near, 0.5 * clearance)
            images = near[:0] if axis is None else reflect(near, axis)
            self._samples = np.concatenate([self._samples, near, images])
        return cage

    def _average(self, moved: TriMesh) -> TriMesh:
        """Return a cage that was moved, its two sides alike where they are to be."""
        axis = self._demand.axis
        return moved if axis is None else average_sides(moved, self._cage, axis)

    def _make_draft(self, clearance: float) -> QuadDraft:
        """Return a draft of the cage with the quads that it has."""
        axis = self._demand.axis
        if axis is None:
            draft = QuadDraft(self._cage, self._samples, clearance)
        else:
            draft = PairedQuadDraft(self._cage, self._samples, clearance, axis)
        for quad in self._quads:
            draft.add(quad)
        return draft

    def _keep_pairs(self, quads: Integers) -> Integers:
        """Return the quads without those whose mirror images are not among them."""
        if self._partners is None:
            return quads
        names = set(name_diagonals(quads))
        return quads[[image in names for image in name_diagonals(self._partners[quads])]]


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


class PairedQuadDraft(PairedDraft, QuadDraft):
    """A draft of a cage with quads that is its own mirror image, and stays so."""
