"""From the triangles of a cage to quads, whichever diagonal cuts which, around the model.

Triangles are paired, and vertices moved to where the quads hold the model by either diagonal, as
far as the cage stays sound. The quads that hold it then are kept, and pairs are chosen again
without those that do not.

The cage is triangles throughout: quads are (q, 4) corners, cut by one diagonal, from the first
corner to the third, which the cage has, or by the other, or by both.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import sparse
from scipy.optimize import Bounds, LinearConstraint, milp

from cageik_cli.cages.builder.draft import (
    Draft,
    Edge,
    Edit,
    PairedDraft,
    flip_edge,
    move_vertex,
    name_edge,
)
from cageik_cli.cages.builder.frame import average_sides, find_partners, reflect
from cageik_cli.cages.builder.judge import Demand, find_near_points, judge, keep_one_per_cell
from cageik_cli.cages.builder.loops import NO_LOOPS, Loops
from cageik_cli.cages.builder.polish import settle, tighten
from cageik_cli.cages.builder.refine import find_contacts, make_draft
from cageik_cli.cages.check.quality import MIN_SHEET_RATIO
from cageik_cli.cages.push import Contacts, make_form, push, solve_moves
from cageik_cli.geometry.attributes import SurfaceAttributes
from cageik_cli.geometry.intersections import crossing_face_pairs, self_intersections
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import corner_angles, cross, measure_angles, thin_face_pairs
from cageik_cli.geometry.surface import closest_points, winding_numbers
from cageik_cli.util.arrays import Floats, Integers, Mask
from cageik_cli.util.text import format_decimals

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

MIN_QUAD_ANGLE = 5.0
"""Degrees that the triangles of a quad have, by either diagonal."""

MAX_FOLD = 45.0
"""Degrees between the normals of the triangles of a quad, by either diagonal: programs cut quads by
the one or by the other, and one that folds more is no face that an artist would draw."""

PAIR_VALUE = 0.5
"""What a quad counts for whatever its shape, which counts for at most one."""

KEPT_PAIR_VALUE = 0.25
"""What a quad counts for in addition that holds the model already: it gives way to two others."""

RIDGE_COST = 0.35
"""What the volume costs that a quad loses by its other diagonal, over the cage's volume for each
two triangles: the cage must grow until that one holds the model, too."""

FLIP_COST = 0.3
"""What a flip costs: a cage is flipped for quads that it would not have otherwise."""

HALVES = ((0, 1, 2), (0, 2, 3), (1, 2, 3), (1, 3, 0))
"""Corners of the triangles of a quad by one diagonal, and by the other."""

Corners = tuple[int, int, int, int]
"""The vertices of a quad; its diagonal in the cage is from the first to the third."""


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
        f"{format_decimals(100 * share, 0)} % of the faces are quads, expected "
        f"{100 * MIN_QUAD_SHARE:g} % or more; the others would fold by more than {MAX_FOLD:g} "
        "degrees, or not hold the model by either diagonal",
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

        Each goes all of the way or half of it. Angles do not become smaller than this, degrees, or
        than they are.
        """
        for _ in range(WALKS):
            for vertex in np.flatnonzero((self.vertices != places).any(axis=1)).tolist():
                here = self.vertices[vertex].copy()
                for share in (1.0, 0.5):
                    edit = move_vertex(self, vertex, here + share * (places[vertex] - here))
                    if self._take_in_shape(edit, angle):
                        break
                    if self._take_in_shape(settle(self, edit), angle):
                        break

    def apply(self, edit: Edit) -> None:
        """Move a vertex, untested; the faces stay in their order."""
        self.vertices[edit.vertex] = edit.position

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


class PairedQuadDraft(PairedDraft, QuadDraft):
    """A draft of a cage with quads that is its own mirror image, and stays so."""


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
    _, near = find_near_points(demand.surface, halves, demand.clearance)
    return np.isin(np.arange(len(quads)), closest_points(halves, near).face // 2)


def find_failing(cage: TriMesh, quads: Integers, demand: Demand, angle: float) -> Mask:
    """Return which quads are at fault, (q,), where the cage fails with any choice of diagonals.

    It fails, too, if a triangle has a smaller angle than this, degrees, or a quad folds.
    """
    failing, count = np.zeros(len(quads), bool), 2 * len(quads)
    cuts = join_quads(cage, quads), turn_diagonals(cage, quads)
    for cut in cuts:
        verdict = judge(TriMesh(cut.vertices, cut.faces), demand)
        if verdict.is_valid and verdict.smallest_angle >= angle:
            continue
        # Faces that cross others, are needles, or are too near to the model or in it.
        _, near = find_near_points(demand.surface, cut, demand.clearance)
        outside = demand.samples[winding_numbers(cut, demand.samples) < 0.5]
        found = [
            self_intersections(cut).ravel(),
            closest_points(cut, np.concatenate([near, outside])).face,
            crossing_face_pairs(demand.surface, cut, 0.0)[:, 1],
            np.flatnonzero(corner_angles(cut).min(axis=1) < angle),
            thin_face_pairs(cut, MIN_SHEET_RATIO)[0].ravel(),
        ]
        bad = np.unique(np.concatenate(found))
        of_quad = bad[bad < count] // 2
        if len(of_quad) == 0:  # what is at fault is beside quads
            of_quad = np.flatnonzero(np.isin(quads, cut.faces[bad]).any(axis=1))
        if len(of_quad) == 0:
            return np.ones(len(quads), bool)
        failing[of_quad] = True
    failing |= measure_folds(cage.vertices, quads) > MAX_FOLD
    # Halves by either diagonal that cross other faces by either diagonal.
    own, turned = (cut.faces for cut in cuts)
    pairs = self_intersections(TriMesh(cage.vertices, np.concatenate([own, turned[:count]])))
    owner = np.full(len(own) + count, -1)
    owner[:count] = owner[len(own) :] = np.repeat(np.arange(len(quads)), 2)
    one, other = owner[pairs].T
    crossing = np.concatenate([one, other])[np.tile(one != other, 2)]
    failing[crossing[crossing >= 0]] = True
    return failing


@dataclass(frozen=True, slots=True)
class _Option:
    """A quad, or two that a flip makes of four triangles.

    Attributes
    ----------
    faces : tuple of int
        The triangles that it takes.
    gone : tuple of Edge
        Edges that are none any more; the last one is that which is flipped.
    others : tuple of Edge
        The other diagonals.
    added : Edge, optional
        The one that a flip adds.
    """

    value: float
    faces: tuple[int, ...]
    gone: tuple[Edge, ...]
    others: tuple[Edge, ...]
    added: Edge | None = None


class Pairing:
    """The quads that pairs of triangles of a cage would be.

    Parameters
    ----------
    cosine : float
        Between the normals of two triangles that are paired, at least: sharper edges stay.
    partners : (n,) int64, optional
        The mirror images of vertices: a quad is chosen with its mirror image.
    """

    def __init__(self, cage: TriMesh, cosine: float, partners: Integers | None = None) -> None:
        self._cage, self._cosine, self._partners = cage, cosine, partners
        self._beside = {  # the face, and its third corner, where a side goes from one to the other
            (face[k - 2], face[k - 1]): (number, face[k])
            for number, face in enumerate(cage.faces.tolist())
            for k in range(3)
        }
        ends = cage.edges.ends.tolist()
        self._quads = np.array(
            [(a, self._beside[b, a][1], b, self._beside[a, b][1]) for a, b in ends], np.int64
        )
        self._values, self._is_usable = self._weigh(self._quads)

    def choose(self, banned: set[Edge], held: set[Edge]) -> Integers:
        """Choose quads, as many and as well shaped ones as can be: (q, 4) corners.

        The diagonal that the cage has is from the first corner to the third. This is the matching
        of greatest value in the graph of triangles that share an edge; vertices keep three edges,
        and no edge is the other diagonal of two quads.

        Parameters
        ----------
        banned, held : set of Edge
            Diagonals of quads that are not to be chosen, and of those that hold the model already.
        """
        at = {edge: k for k, edge in enumerate(name_diagonals(self._quads))}
        chosen = self._solve(self._list_pairs(banned, held))
        return np.asarray(self._quads[sorted(at[option.gone[0]] for option in chosen)])

    def choose_flips(self, banned: set[Edge]) -> list[Edge]:
        """Choose the edges whose flips give more quads, apart from those that are banned."""
        chosen = self._solve([*self._list_pairs(set(), set()), *self._list_flips(banned)])
        return [option.gone[-1] for option in chosen if option.added is not None]

    def _weigh(self, quads: Integers) -> tuple[Floats, list[bool]]:
        """Return what quads count for, and which may be chosen: those whose diagonal is no edge."""
        vertices = self._cage.vertices
        scores = score_quads(vertices, quads, self._cosine)
        is_free = [(start, stop) not in self._beside for start, stop in quads[:, [1, 3]].tolist()]
        volume = 2 * abs(self._cage.volume) / len(self._cage.faces)
        growth = np.maximum(measure_ridges(vertices, quads), 0) / volume
        usable = (scores > 0) & np.array(is_free, bool)
        return PAIR_VALUE + scores - RIDGE_COST * growth, usable.tolist()

    def _list_pairs(self, banned: set[Edge], held: set[Edge]) -> list[_Option]:
        """List the quads around edges."""
        options = []
        for (a, d, b, c), value, usable in zip(
            self._quads.tolist(), self._values.tolist(), self._is_usable, strict=True
        ):
            edge = name_edge(a, b)
            if (usable or edge in held) and edge not in banned:
                faces = self._beside[a, b][0], self._beside[b, a][0]
                value += KEPT_PAIR_VALUE * (edge in held)
                options.append(_Option(value, faces, (edge,), (name_edge(c, d),)))
        return options

    def _list_flips(self, banned: set[Edge]) -> list[_Option]:
        """List two quads for each flip, each of a new triangle and one beside it."""
        flips: list[tuple[Edge, Edge, tuple[int, ...]]] = []  # what goes, what comes, four faces
        made: list[list[Corners]] = []
        for a, d, b, c in self._quads[self._is_usable].tolist():
            if name_edge(a, b) in banned:
                continue
            # The new triangles are a, d, c and d, b, c: a side of each, and its third corner.
            for sides in product(((a, d, c), (c, a, d)), ((d, b, c), (b, c, d))):
                beside = [self._beside[stop, start] for start, stop, _ in sides]
                faces = beside[0][0], beside[1][0], self._beside[a, b][0], self._beside[b, a][0]
                if len({*faces}) == 4:
                    flips.append((name_edge(a, b), name_edge(c, d), faces))
                    made.append([(p, beside[k][1], q, tip) for k, (p, q, tip) in enumerate(sides)])
        if not flips:
            return []
        quads = np.array(made, np.int64)
        values, usable = self._weigh(quads.reshape(-1, 4))
        options = []
        for k, (edge, added, taken) in enumerate(flips):
            if usable[2 * k] and usable[2 * k + 1]:
                value = float(values[2 * k : 2 * k + 2].sum()) - FLIP_COST
                gone = (*sorted(name_diagonals(quads[k])), edge)
                others = name_diagonals(np.roll(quads[k], 1, axis=1))
                options.append(_Option(value, taken, gone, (*others,), added))
        return options

    def _solve(self, options: list[_Option]) -> list[_Option]:
        """Choose the options of the greatest value that go together."""
        if not options:
            return []
        count, faces = len(self._cage.vertices), self._cage.faces
        lost = _count([sum(option.gone, ()) for option in options], count)
        gained = _count([option.added or () for option in options], count)
        at: dict[Edge, int] = {}
        others = [[at.setdefault(edge, len(at)) for edge in option.others] for option in options]
        constraints = [
            LinearConstraint(_count([option.faces for option in options], len(faces)), ub=1),
            LinearConstraint(lost - gained, ub=np.bincount(faces.ravel(), minlength=count) - 3),
            LinearConstraint(_count(others, len(at)), ub=1),
        ]
        if self._partners is not None:
            # The differences between options and their mirror images, or those without one.
            places = {option.gone: k for k, option in enumerate(options)}
            ties = sparse.lil_array((len(options), len(options)))
            for k, option in enumerate(options):
                ends = [name_edge(*edge) for edge in self._partners[list(option.gone)].tolist()]
                image = places.get((*sorted(ends[:-1]), ends[-1]))
                ties[k, k] = 0 if image == k else 1
                if image is not None and image != k:
                    ties[k, image] = -1
            constraints.append(LinearConstraint(sparse.csr_array(ties), lb=0, ub=0))
        found = milp(
            [-option.value for option in options],
            integrality=np.ones(len(options)),
            bounds=Bounds(0, 1),
            constraints=constraints,
        )
        return [option for option, x in zip(options, found.x, strict=True) if x > 0.5]


def name_diagonals(quads: Integers) -> list[Edge]:
    """Return the diagonals of quads from their first corners to their third."""
    return [name_edge(start, stop) for start, stop in quads[:, [0, 2]].tolist()]


def _count(uses: Sequence[Sequence[int]], count: int) -> sparse.csr_array:
    """Return the matrix that counts how often each of `count` things is used, (count, k)."""
    columns = np.repeat(np.arange(len(uses)), [len(used) for used in uses])
    rows = np.array([row for used in uses for row in used], np.int64)
    return sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(count, len(uses)))


def score_quads(vertices: Floats, quads: Integers, min_cosine: float) -> Floats:
    """Return how square and flat quads are, (q,), 0 to 1; 0 for those that may not be."""
    corners = vertices[quads]
    angles = np.stack([measure_angles(corners[:, half]).min(axis=1) for half in map(list, HALVES)])
    a, b, c = corners[:, HALVES].transpose(2, 1, 0, 3)
    normals = cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-300)
    whole = normals[0] + normals[1]
    is_convex = ((normals * whole).sum(axis=2) > 0.1).all(axis=0)
    cosine = (normals[0] * normals[1]).sum(axis=1)
    usable = is_convex & (cosine > min_cosine) & (angles.min(axis=0) > MIN_QUAD_ANGLE)
    ahead = np.roll(corners, -1, axis=1) - corners
    back = np.roll(corners, 1, axis=1) - corners
    turn = (ahead * back).sum(axis=2)
    turn /= np.linalg.norm(ahead, axis=2) * np.linalg.norm(back, axis=2)
    squareness = 1 - np.abs(turn).max(axis=1)
    return np.where(usable, squareness * np.maximum(cosine, 0), 0.0)


def measure_ridges(vertices: Floats, quads: Integers) -> Floats:
    """Return the volume that quads lose by their other diagonal, (q,); negative for valleys."""
    a, d, b, c = vertices[quads].transpose(1, 0, 2)
    return np.asarray((cross(b - a, d - a) * (c - a)).sum(axis=1) / 6)


def measure_folds(vertices: Floats, quads: Integers) -> Floats:
    """Return the degrees between the triangles of quads, (q,): the larger of both diagonals."""
    a, b, c = vertices[quads][:, HALVES].transpose(2, 1, 0, 3)  # each (4, q, 3)
    normals = cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=2)
    cosines = (normals[::2] * normals[1::2]).sum(axis=2)
    cosines /= np.maximum(lengths[::2] * lengths[1::2], 1e-300)
    return np.asarray(np.degrees(np.arccos(np.clip(cosines, -1, 1))).max(axis=0))
