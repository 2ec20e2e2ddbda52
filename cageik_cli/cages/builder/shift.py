"""Move vertices of a cage from where a motion does not need them to where its error is."""

import numpy as np

from cageik_cli.cages.builder.draft import Draft
from cageik_cli.cages.builder.judge import Demand
from cageik_cli.cages.builder.loops import NO_LOOPS, Loops
from cageik_cli.cages.builder.motion import EditGains, Motion
from cageik_cli.cages.builder.polish import (
    MIN_KEPT_ANGLE,
    collapse_in_shape,
    splits_well,
    tighten,
)
from cageik_cli.cages.builder.refine import complete_clearance, make_draft
from cageik_cli.cages.check.quality import find_thin_parts
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers

SKIPPED = ((0, 0), (1, 0), (0, 1))
"""How many of the best splits and collapses are left out, after each round of one that failed."""


def shift_vertices(
    cage: TriMesh, demand: Demand, motion: Motion, loops: Loops = NO_LOOPS
) -> tuple[TriMesh, int]:
    """Collapse the edges that a motion needs least, and split as many where it gains most.

    The first round moves 8 % of the vertices; a round that fails halves that.

    Returns
    -------
    TriMesh
        The cage, in the units of the demand.
    int
        How many vertices moved.
    """
    cage, samples = complete_clearance(cage, demand, demand.samples, rounds=2)
    shifter = _Shifter(cage, samples, demand, motion, loops)
    count, failures = max(1, round(0.08 * len(cage.vertices))), 0
    for _ in range(count_rounds(len(cage.vertices))):
        if shifter.try_round(count, SKIPPED[failures]):
            failures = 0
        elif count > 1:
            count = (count + 1) // 2
        elif failures + 1 < len(SKIPPED):
            failures += 1
        else:
            break
    cage, _ = complete_clearance(shifter.cage, demand, samples)
    return cage, shifter.moved


def count_rounds(vertices: int) -> int:
    """Return how many rounds a cage gets, for their time: 80, of 300 vertices or less.

    The time of a round grows with the cube of their number.
    """
    return max(1, int(80 * min(1.0, 300 / vertices) ** 3))


class _Shifter:
    """A cage whose vertices are moved as long as its error falls.

    Attributes
    ----------
    cage : TriMesh
        The best one so far.
    moved : int
        How many vertices moved.
    """

    def __init__(
        self, cage: TriMesh, samples: Floats, demand: Demand, motion: Motion, loops: Loops
    ) -> None:
        self.cage, self.moved, self._loops = cage, 0, loops
        self._samples, self._demand, self._motion = samples, demand, motion
        self._gains = EditGains(cage, motion, EditGains(cage, motion).squares)

    def try_round(self, count: int, skipped: tuple[int, int]) -> bool:
        """Move up to `count` vertices, without some best edits; return whether the error fell.

        Sheets of the cage that nearly touch must not come nearer to each other, either.
        """
        draft = make_draft(self.cage, self._demand, self._samples, self._loops)
        made = _Round(draft, self._gains).run(count, skipped, self._demand.most)
        if made == 0:
            return False
        cage = draft.to_mesh()
        before, after = (
            min((fault.value for fault in find_thin_parts(each)), default=np.inf)
            for each in (self.cage, cage)
        )
        if after < before:
            return False
        gains = EditGains(cage, self._motion, self._gains.squares)
        if not gains.error < self._gains.error:
            return False
        self.cage, self._gains = cage, gains
        self.moved += made
        return True


class _Round:
    """Edits of a draft that do not touch each other, so that their gains add up nearly."""

    def __init__(self, draft: Draft, gains: EditGains) -> None:
        self._draft, self._gains = draft, gains
        self._touched: set[int] = set()  # vertices whose faces were edited

    def run(self, count: int, skipped: tuple[int, int], most: int) -> int:
        """Move up to `count` vertices, to `most` vertices in all; return how many were added.

        So many of the best splits and collapses are left out.
        """
        gains = self._gains
        order = np.argsort(-gains.gains, kind="stable")
        splits = [k for k in order if self._is_splittable(*gains.splits[k])][skipped[0] :]
        kept = {int(v) for k in splits[:count] for v in self._around_edge(*gains.splits[k])}
        # A vertex moves if the collapse costs clearly less than the split gains.
        self._collapse_edges(0.9 * gains.gains[splits][:count], kept, skipped[1])
        done, free = 0, most - self._draft.count
        for start, stop in gains.splits[splits].tolist():
            around = {start, stop, *self._around_edge(start, stop).tolist()}
            # An edge that was collapsed has no faces any more, but its ends are touched.
            is_free = done < free and not self._touched & around
            if is_free and self._is_splittable(start, stop):
                self._touched |= {*around, self._draft.split(start, stop)}
                done += 1
        tighten(self._draft, self._draft.samples, self._touched)
        return done

    def _collapse_edges(self, worth: Floats, kept: set[int], left_out: int) -> None:
        """Collapse edges, apart from `kept` vertices, that cost less than splits are worth."""
        made, losses = 0, self._gains.losses
        for k in np.argsort(losses, kind="stable"):
            if made == len(worth) or losses[k] > worth[made]:
                break
            start, stop = map(int, self._gains.edges[k])
            around = {v for end in (start, stop) for v in self._draft.neighbours(end).tolist()}
            if around & (kept | self._touched):
                continue
            if left_out > 0:
                left_out -= 1
                continue
            if any(collapse_in_shape(self._draft, start, stop, share) for share in (0.5, 0, 1)):
                self._touched |= around
                made += 1

    def _is_splittable(self, start: int, stop: int) -> bool:
        valence = self._draft.count_faces()
        return splits_well(self._draft, int(start), int(stop), valence, MIN_KEPT_ANGLE)

    def _around_edge(self, start: int, stop: int) -> Integers:
        """Return the vertices of the faces at an edge."""
        return np.unique(self._draft.faces[self._draft.faces_at_edge(int(start), stop)])
