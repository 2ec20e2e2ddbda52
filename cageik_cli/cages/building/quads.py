"""From the triangles of a cage to quads, whichever diagonal cuts which, around the model.

Triangles are paired, and vertices moved to where the quads hold the model by either diagonal, as
far as the cage stays sound. The quads that hold it then are kept, and pairs are chosen again
without those that do not.
"""

import numpy as np

from cageik_cli.cages.building.judge import Demand, keep_one_per_cell
from cageik_cli.cages.building.loops import NO_LOOPS, Loops
from cageik_cli.cages.building.pairing import MIN_QUAD_ANGLE, Pairing, name_diagonals
from cageik_cli.cages.building.polish import flip_edge, tighten
from cageik_cli.cages.building.quad_cuts import (
    find_failing,
    find_near_cuts,
    find_near_quads,
    fit_cuts,
    join_quads,
    push_cuts,
)
from cageik_cli.cages.building.quad_draft import PairedQuadDraft, QuadDraft
from cageik_cli.cages.building.refine import make_draft
from cageik_cli.cages.building.symmetry import average_sides, find_partners, reflect
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import corner_angles
from cageik_cli.util.arrays import Integers

MIN_QUAD_SHARE = 0.7
"""A smaller share of quads among the faces of a cage is noted."""

MAX_PAIRINGS = 5
"""How often triangles are paired, each time without the pairs that failed before."""

MAX_CLEARED = 5
"""Rounds of pushes, each with the points that were too near after the last one."""

PAIRED_COSINES = (0.3, 0.3, 0.1)
"""Between the normals of triangles that are paired, at least, in each round of pairing and fitting;
the last one is for cages that have few quads after the others."""


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
        if self._share < MIN_QUAD_SHARE:
            self._pair_triangles(PAIRED_COSINES[-1])
        self._tighten()
        self._drop_failing()
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

    @property
    def _share(self) -> float:
        """The share of quads among the faces."""
        return len(self._quads) / (len(self._cage.faces) - len(self._quads))

    def _pair_triangles(self, cosine: float) -> None:
        """Pair triangles, keep the quads that hold the model, and fit the cage to it."""
        failed = set(self._loops.edges)
        for _ in range(MAX_PAIRINGS):
            held = set(name_diagonals(self._quads))
            quads = Pairing(self._cage, cosine, self._partners).choose(failed, held)
            is_held = np.array([edge in held for edge in name_diagonals(quads)], bool)
            if is_held.all():
                break
            self._quads = quads[is_held]
            self._hold(quads[~is_held])
            failed |= set(name_diagonals(quads)) - set(name_diagonals(self._quads))
        # Pushed off the model for quads that failed, too, it is far away; flatter, it pairs better.
        fitted = self._average(fit_cuts(self._cage, self._quads, self._demand))
        self._walk(fitted, self._quads, 1.01 * self._demand.clearance)

    def _hold(self, added: Integers) -> None:
        """Push the cage until it holds the model with these quads, too; keep those that do."""
        self._walk(self._cage, np.concatenate([self._quads, added]), self._demand.clearance)
        added = added[~find_near_quads(self._cage, added, self._demand)]
        draft = self._make_draft(self._demand.clearance)
        added = added[[draft.hold(quad, self._angle) for quad in added]]
        self._quads = self._keep_pairs(np.concatenate([self._quads, added]))

    def _tighten(self) -> None:
        """Pull one vertex after the other towards the model."""
        draft = self._make_draft(1.01 * self._demand.clearance)
        tighten(draft, self._samples)
        self._cage = TriMesh(draft.vertices, self._cage.faces)

    def _drop_failing(self) -> None:
        """Complete the clearance, and drop quads until the cage passes all tests."""
        while len(self._quads):
            self._cage = self._clear(self._cage, self._quads)
            failing = find_failing(self._cage, self._quads, self._demand, self._angle)
            if not failing.any():
                break
            self._quads = self._keep_pairs(self._quads[~failing])

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
