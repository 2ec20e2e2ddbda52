"""Loops of a few vertices around the limbs of a cage, more where they bend: faces follow them.

The limbs of a fine shell are replaced by coarse tubes of quads, and the rest is decimated around
them. The vertices of loops are the first ones of a cage.
"""

from dataclasses import dataclass

import numpy as np

from cageik_cli.cages.building.collapse import COLLAPSE_LIMITS, Collapser
from cageik_cli.cages.building.draft import Edge, name_edge
from cageik_cli.cages.building.limbs import find_limbs
from cageik_cli.cages.building.loop_plan import MAX_LOOP_MISFIT, LoopPlan
from cageik_cli.cages.building.motion import Motion
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers

MAX_LOOP_SHARE = 0.55
"""The share of the vertices of a cage that loops may have."""


@dataclass(frozen=True, slots=True, eq=False)
class Loops:
    """The loops of a cage.

    Attributes
    ----------
    tubes : tuple of (l, k) int64
        The vertices of the loops of each limb, from its base to its tip; together they are the
        first ones of the cage.
    """

    tubes: tuple[Integers, ...]

    @property
    def vertex_count(self) -> int:
        """Return the number of vertices in loops."""
        return sum(tube.size for tube in self.tubes)

    @property
    def count(self) -> int:
        """Return the number of loops."""
        return sum(len(tube) for tube in self.tubes)

    @property
    def edges(self) -> frozenset[Edge]:
        """Return the edges of the loops, and those from one to the next."""
        ends = []
        for tube in self.tubes:
            around, along = (tube, np.roll(tube, -1, axis=1)), (tube[:-1], tube[1:])
            ends += [np.stack(pair, axis=-1).reshape(-1, 2) for pair in (around, along)]
        return frozenset(name_edge(*edge) for edges in ends for edge in edges.tolist())


NO_LOOPS = Loops(())


def lay_loops(shell: TriMesh, count: int, motion: Motion | None) -> tuple[TriMesh, Loops]:
    """Put tubes in the place of limbs of a shell that becomes a cage of `count` vertices."""
    plans = [LoopPlan(shell, limb, motion, count) for limb in find_limbs(shell)]
    chosen = _choose_limbs(shell, plans, int(MAX_LOOP_SHARE * count))
    return (shell, NO_LOOPS) if not chosen else _replace_limbs(shell, chosen)


def _choose_limbs(shell: TriMesh, plans: list[LoopPlan], most: int) -> list[LoopPlan]:
    """Choose limbs, the first ones first, and add loops where they miss most.

    Loops have `most` vertices in all.
    """
    chosen: list[LoopPlan] = []
    is_taken = np.zeros(len(shell.vertices), bool)
    for plan in plans:
        while plan.misfit > MAX_LOOP_MISFIT:
            plan.add_loop()
        corners = shell.faces[plan.faces]
        # Between the borders of two limbs there are faces.
        if 0 < plan.vertex_count <= most and not is_taken[corners].any():
            chosen.append(plan)
            is_taken[corners] = True
            most -= plan.vertex_count
    while growing := [plan for plan in chosen if plan.has_room and plan.sides <= most]:
        worst = max(growing, key=lambda plan: plan.misfit)
        worst.add_loop()
        most -= worst.sides
    return chosen


def _replace_limbs(shell: TriMesh, plans: list[LoopPlan]) -> tuple[TriMesh, Loops]:
    """Put the tubes of plans in the place of their faces; the vertices of tubes come first."""
    is_gone = np.isin(np.arange(len(shell.faces)), np.concatenate([plan.faces for plan in plans]))
    loops = [plan.loops for plan in plans]
    bounds = np.cumsum([0, *(loop[..., 0].size for loop in loops)])
    kept, core = np.unique(shell.faces[~is_gone], return_inverse=True)
    places = np.concatenate([*(loop.reshape(-1, 3) for loop in loops), shell.vertices[kept]])
    faces, tubes = [bounds[-1] + core.reshape(-1, 3)], []
    for plan, first, stop in zip(plans, bounds[:-1], bounds[1:], strict=True):
        assert plan.border is not None
        tube = np.arange(first, stop).reshape(-1, plan.sides)
        border = bounds[-1] + np.searchsorted(kept, plan.border)
        faces += [_join_rings(places, border, tube[0]), *_list_faces(tube)]
        tubes.append(tube)
    return TriMesh(places, np.concatenate(faces)), Loops(tuple(tubes))


def _list_faces(tube: Integers) -> list[Integers]:
    """Return the faces between the loops of a tube, and over the last one."""
    low, high = tube[:-1], tube[1:]
    low_next, high_next = (np.roll(rings, -1, axis=1) for rings in (low, high))
    end = tube[-1]
    return [
        np.stack([low, low_next, high_next], axis=-1).reshape(-1, 3),
        np.stack([low, high_next, high], axis=-1).reshape(-1, 3),
        np.stack([np.repeat(end[0], len(end) - 2), end[1:-1], end[2:]], axis=1),
    ]


def _join_rings(places: Floats, border: Integers, loop: Integers) -> Integers:
    """Return faces between a border and a loop that go the same way around."""
    apart = np.linalg.norm(places[border][:, None] - places[loop], axis=2)
    start, at = np.unravel_index(apart.argmin(), apart.shape)
    rings = np.roll(border, -start).tolist(), np.roll(loop, -at).tolist()
    lengths = [np.linalg.norm(places[np.roll(r, -1)] - places[r], axis=1) for r in rings]
    ends = [(way.cumsum() / way.sum(), np.full(len(way), k)) for k, way in enumerate(lengths)]
    shares, which = (np.concatenate(parts) for parts in zip(*ends, strict=True))
    faces, step = [], [0, 0]
    for ring in which[np.lexsort((which, np.round(shares, 12)))].tolist():
        a, c = rings[0][step[0] % len(border)], rings[1][step[1] % len(loop)]
        step[ring] += 1
        faces.append([a, rings[ring][step[ring] % len(rings[ring])], c])
    return np.array(faces)


def collapse_around(
    cage: TriMesh, count: int, motion: Motion | None, evenness: float, loops: Loops
) -> TriMesh:
    """Collapse edges until there are `count` vertices, as `collapse_edges` does; loops stay."""
    fixed = loops.vertex_count
    for angle, valence, cosine in COLLAPSE_LIMITS:
        if len(cage.vertices) > count:
            collapser = _CollapserAround(
                cage, motion, evenness, fixed, angle=angle, valence=valence, cosine=cosine
            )
            cage = collapser.run(count)
    return cage


class _CollapserAround(Collapser):
    """A collapser that leaves the first vertices of a mesh, `fixed` ones, where they are."""

    def __init__(
        self,
        cage: TriMesh,
        motion: Motion | None,
        evenness: float,
        fixed: int,
        *,
        angle: float,
        valence: int,
        cosine: float,
    ) -> None:
        self._fixed = fixed
        super().__init__(cage, motion, evenness, angle=angle, valence=valence, cosine=cosine)

    def _push(self, ends: Integers) -> None:
        super()._push(ends[ends.max(axis=1) >= self._fixed])

    def _weigh(self, ends: Integers) -> tuple[Floats, Floats]:
        costs, targets = super()._weigh(ends)
        is_fixed = ends < self._fixed
        one = is_fixed.any(axis=1)
        targets[one] = self._places[:, ends[is_fixed]].transpose(1, 0, 2)
        total = self._quadrics[:, ends[one]].sum(axis=2)
        places = np.concatenate([targets[one], np.ones((*targets[one].shape[:2], 1))], axis=2)
        costs[one] = np.einsum("epi,peij,epj->e", places, total, places)
        return costs, targets

    def _collapse(self, a: int, b: int, places: Floats) -> None:
        super()._collapse(*((b, a) if b < self._fixed else (a, b)), places)
