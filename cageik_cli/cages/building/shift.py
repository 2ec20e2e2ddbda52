"""Move vertices of a cage from where a motion does not need them to where its error is."""

from dataclasses import dataclass, field
from typing import Self

import numpy as np

from cageik_cli.cages.building.draft import Draft
from cageik_cli.cages.building.judge import Demand
from cageik_cli.cages.building.motion import EditGains, Motion, measure_edits
from cageik_cli.cages.building.polish import (
    KEPT_ANGLE,
    collapse_in_shape,
    lower_valences,
    mend_angles,
    splits_well,
    tighten,
)
from cageik_cli.cages.building.refine import complete_clearance, make_draft
from cageik_cli.cages.quality import find_thin_parts
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers

FIRST_SHARE = 0.08
"""Share of the vertices that the first round moves; a round that fails halves it."""

MAX_ROUNDS = 80
"""Rounds, at most,"""

FULL_VERTICES = 300
"""of a cage with so many vertices. The time of a round grows with the cube of their number."""

SKIPPED = ((0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (0, 2), (2, 1), (1, 2), (3, 0), (0, 3))
"""How many of the best splits and collapses are left out, after each round of one that failed."""

POLISH_GAIN = 0.995
"""A polish is kept if it lowers the error to this share."""

WORTH = 0.9
"""A vertex moves if the collapse costs at most this share of what the split gains."""


def shift_vertices(cage: TriMesh, demand: Demand, motion: Motion) -> tuple[TriMesh, int]:
    """Collapse the edges that a motion needs least, and split as many where it gains most.

    Returns
    -------
    TriMesh
        The cage, in the units of the demand.
    int
        How many vertices moved.
    """
    cage, samples = complete_clearance(cage, demand, demand.samples, rounds=2)
    shifter = _Shifter.start(cage, samples, demand, motion)
    count, failures = max(1, round(FIRST_SHARE * len(cage.vertices))), 0
    for _ in range(count_rounds(len(cage.vertices))):
        if shifter.try_round(count, SKIPPED[failures]):
            failures = 0
        elif count > 1:
            count = (count + 1) // 2
        elif failures + 1 < len(SKIPPED):
            failures += 1
        elif shifter.try_polish():
            failures = 0
        else:
            break
    cage, _ = complete_clearance(shifter.cage, demand, samples)
    return cage, shifter.moved


def count_rounds(vertices: int) -> int:
    """Return how many rounds a cage gets, so that all take minutes."""
    return max(1, int(MAX_ROUNDS * min(1.0, FULL_VERTICES / vertices) ** 3))


@dataclass(slots=True, eq=False)
class _Shifter:
    """A cage whose vertices are moved as long as its error falls.

    Attributes
    ----------
    cage : TriMesh
        The best one so far.
    gains : EditGains
        Its error, and what edits of it change.
    samples : (s, 3) float64
        Points that it holds.
    moved : int
        How many vertices moved.
    """

    cage: TriMesh
    gains: EditGains
    samples: Floats
    demand: Demand
    motion: Motion
    moved: int = 0

    @classmethod
    def start(cls, cage: TriMesh, samples: Floats, demand: Demand, motion: Motion) -> Self:
        """Measure a cage."""
        squares = measure_edits(cage, motion).squares
        return cls(cage, measure_edits(cage, motion, squares), samples, demand, motion)

    def try_round(self, count: int, skipped: tuple[int, int]) -> bool:
        """Move up to `count` vertices, without some best edits; return whether the error fell."""
        draft = self._make_draft()
        made = _Round(draft, self.gains, skipped).run(count, self.demand.most)
        if made == 0 or not self._accept(draft.to_mesh(), share=1.0):
            return False
        self.moved += made
        return True

    def try_polish(self) -> bool:
        """Improve the angles and the fit; return whether the error fell."""
        draft = self._make_draft()
        tighten(draft, draft.samples)
        mend_angles(draft, draft.count)
        lower_valences(draft)
        return self._accept(draft.to_mesh(), POLISH_GAIN)

    def _make_draft(self) -> Draft:
        return make_draft(self.cage, self.demand, self.samples)

    def _accept(self, cage: TriMesh, share: float) -> bool:
        """Take a cage in the place of the last if its error is below a share of the last one's."""
        if not _is_no_thinner(cage, self.cage):
            return False
        gains = measure_edits(cage, self.motion, self.gains.squares)
        if not gains.error < share * self.gains.error:
            return False
        self.cage, self.gains = cage, gains
        return True


def _is_no_thinner(after: TriMesh, before: TriMesh) -> bool:
    """Return whether sheets of a cage that nearly touch were as near before."""
    nearest = [min((f.value for f in find_thin_parts(c)), default=np.inf) for c in (after, before)]
    return bool(nearest[0] >= nearest[1])


@dataclass(slots=True, eq=False)
class _Round:
    """Edits that do not touch each other, so that their gains add up nearly.

    Attributes
    ----------
    skipped : (int, int)
        How many of the best splits and collapses are left out.
    touched : set of int
        Vertices whose faces were edited in this round.
    """

    draft: Draft
    gains: EditGains
    skipped: tuple[int, int]
    touched: set[int] = field(default_factory=set)

    def run(self, count: int, most: int) -> int:
        """Move up to `count` vertices, to `most` vertices in all; return how many were added."""
        order = np.argsort(-self.gains.gains, kind="stable")
        splits = [k for k in order if self._is_splittable(*self.gains.splits[k])]
        splits = splits[self.skipped[0] :]
        kept = {int(v) for k in splits[:count] for v in self._around_edge(*self.gains.splits[k])}
        worth = WORTH * self.gains.gains[splits]
        self._collapse_edges(worth[:count], kept)
        done, free = 0, most - self.draft.count
        for k in splits:
            if done < free and self._split(*self.gains.splits[k]):
                done += 1
        tighten(self.draft, self.draft.samples, self.touched)
        return done

    def _collapse_edges(self, worth: Floats, kept: set[int]) -> None:
        """Collapse edges, apart from `kept` vertices, that cost less than splits are worth."""
        made, left_out, losses = 0, self.skipped[1], self.gains.losses
        for k in np.argsort(losses, kind="stable"):
            if made == len(worth) or losses[k] > worth[made]:
                break
            start, stop = map(int, self.gains.edges[k])
            around = {*self.draft.neighbours(start).tolist(), *self.draft.neighbours(stop).tolist()}
            if around & (kept | self.touched):
                continue
            if left_out > 0:
                left_out -= 1
                continue
            if any(collapse_in_shape(self.draft, start, stop, share) for share in (0.5, 0, 1)):
                self.touched |= around
                made += 1

    def _is_splittable(self, start: int, stop: int) -> bool:
        valence = np.bincount(self.draft.faces.ravel(), minlength=len(self.draft.vertices))
        return splits_well(self.draft, int(start), int(stop), valence, KEPT_ANGLE)

    def _split(self, start: int, stop: int) -> bool:
        around = self._around_edge(start, stop)
        # An edge that was collapsed has no faces any more, but its ends are touched.
        if self.touched & {start, stop, *around.tolist()} or not self._is_splittable(start, stop):
            return False
        self.touched |= {*around.tolist(), self.draft.split(int(start), int(stop))}
        return True

    def _around_edge(self, start: int, stop: int) -> Integers:
        """Return the vertices of the faces at an edge."""
        at = self.draft.faces_at(int(start))
        return np.unique(self.draft.faces[at[(self.draft.faces[at] == stop).any(axis=1)]])
