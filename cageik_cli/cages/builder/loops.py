"""Loops of a few vertices around the limbs of a cage, more where they bend: faces follow them.

The limbs of a fine shell are replaced by coarse tubes of quads, whose loops go around sections of
the limb, apart from each other. The rest is decimated around them. The vertices of loops are the
first ones of a cage.
"""

from dataclasses import dataclass

import igl
import numpy as np

from cageik_cli.cages.builder.collapse import COLLAPSE_LIMITS, CollapseLimits, Collapser
from cageik_cli.cages.builder.draft import Edge, name_edge
from cageik_cli.cages.builder.limbs import Limb, find_centre, find_limbs, measure_length
from cageik_cli.cages.builder.motion import Motion
from cageik_cli.geometry.mesh import Edges, TriMesh
from cageik_cli.util.arrays import Floats, Integers, Mask

MAX_LOOP_SHARE = 0.55
"""The share of the vertices of a cage that loops may have."""

MIN_SIDES, MAX_SIDES = 4, 6
"""Vertices of a loop: as many as edges of the cage's mean length go around the limb, or nearest."""

MAX_LOOP_DENSITY = 1.4
"""A limb gets loops beyond those that it needs up to its share of the vertices, by its area, times
this."""

LOOP_PLACES = 24
"""Places along a limb that a loop may have."""

LOOP_TURNS = 12
"""Turns of the loops of a limb about it that are tried."""

MIN_LOOP_MISFIT, MAX_LOOP_MISFIT = 0.05, 0.25
"""How far a limb may miss the tube between two loops, in mean edges of the cage: below the first,
no other loop is needed; above the second, loops are added while others are apart from them."""

EXPECTED_BEND = 0.15
"""How far a limb will bend off the tube where no animation is known, over the distance from the
nearest loop."""


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


def place_edge_loops(shell: TriMesh, count: int, motion: Motion | None) -> tuple[TriMesh, Loops]:
    """Put tubes in the place of limbs of a shell that becomes a cage of `count` vertices."""
    plans = [LoopPlan(shell, limb, motion, count) for limb in find_limbs(shell)]
    chosen = _choose_limbs(shell, plans, int(MAX_LOOP_SHARE * count))
    return (shell, NO_LOOPS) if not chosen else _replace_limbs(shell, chosen)


class LoopPlan:
    """The loops that a limb may have at `LOOP_PLACES`, and which of them it gets.

    Attributes
    ----------
    faces : (f,) int64
        The faces of the shell that the tube replaces.
    border : (b,) int64, optional
        The vertices around them, in their direction; None if they are no disk.
    chosen : list of int
        The places of its loops, ascending; none if no two loops are apart from each other.
    sides : int
        Vertices of a loop: edges are about as long as those of a cage of `count` vertices.
    misfit : float
        How far the limb misses the tube between them at most, in mean edges of the cage.
    """

    def __init__(self, shell: TriMesh, limb: Limb, motion: Motion | None, count: int) -> None:
        inset = min(0.4 * limb.diameter, 0.2 * (limb.tip - limb.base))
        self._heights = np.linspace(limb.base + 0.1 * inset, limb.tip - inset, LOOP_PLACES)
        sections = limb.cut(self._heights)
        # The last loop holds the tip, with the shape of a section before it.
        self._centres = limb.line.place(np.append(self._heights[:-1], limb.tip))
        self._ways = limb.line.find_directions(self._heights, 0.04 * (limb.tip - limb.base))
        area = shell.face_areas
        # A cage of n vertices has about 2n faces; here they are equilateral.
        self._edge = float(np.sqrt(2 / np.sqrt(3) * area.sum() / count))
        self.sides = min(max(MIN_SIDES, round(np.pi * limb.diameter / self._edge)), MAX_SIDES)
        self._loops = _make_loops(sections, self._centres, self._ways, self.sides)
        self._traces = _trace(sections, motion)
        self._bend = EXPECTED_BEND if motion is None else 0.0
        self.faces = np.flatnonzero(np.isin(shell.faces, limb.beyond).any(axis=1))
        self.border = find_border(shell.faces[self.faces])
        self._most = MAX_LOOP_DENSITY * area[self.faces].sum() / area.sum() * count
        self.chosen: list[int] = []
        self.misfit, self._worst = 0.0, -1
        self._is_disjoint = self._compare_loops()
        if self.border is not None:
            around = shell.vertices[self.border]
            starts = [  # the loops whose planes have the whole border below them
                k
                for k in range(LOOP_PLACES // 2)
                if ((around - self._centres[k]) @ self._ways[k] < 0).all()
            ]
            if starts and self._is_disjoint[starts[0], -1]:
                self.chosen = [starts[0], LOOP_PLACES - 1]
                self._measure()

    @property
    def can_add_loop(self) -> bool:
        """Return whether another loop is worth its vertices."""
        return self.vertex_count < self._most and self.misfit > MIN_LOOP_MISFIT

    @property
    def vertex_count(self) -> int:
        """Return the number of vertices of its loops."""
        return len(self.chosen) * self.sides

    @property
    def loops(self) -> Floats:
        """Return the places of the vertices of its loops, (l, k, 3)."""
        return self._loops[self.chosen]

    def add_loop(self) -> None:
        """Add a loop where the limb misses the tube most."""
        self.chosen = sorted([*self.chosen, self._worst])
        self._measure()

    def _compare_loops(self) -> Mask:
        """Return whether the second of two loops is beyond the first, and that below it.

        Loops whose spheres do not meet are apart, too, such as those on both sides of a bend.
        """
        away = self._loops[None] - self._centres[:, None, None]
        heights = np.einsum("pqkx,px->pqk", away, self._ways)
        radii = np.linalg.norm(self._loops - self._centres[:, None], axis=2).max(axis=1)
        distances = np.linalg.norm(self._centres[:, None] - self._centres, axis=2)
        is_far = np.triu(distances > radii[:, None] + radii)
        return np.asarray(is_far | ((heights > 0).all(axis=2) & (heights < 0).all(axis=2).T))

    def _measure(self) -> None:
        """Find where the tube misses the limb most; only where a loop is apart from the others."""
        chosen, k = np.array(self.chosen), np.arange(LOOP_PLACES)
        after = np.clip(np.searchsorted(chosen, k), 1, len(chosen) - 1)
        low, high = chosen[after - 1], chosen[after]
        at, start, stop = (self._heights[places] for places in (k, low, high))
        share = ((at - start) / (stop - start))[:, None]
        tube = (1 - share) * self._traces[:, low] + share * self._traces[:, high]
        misfit = np.linalg.norm(self._traces - tube, axis=2).max(axis=0)
        misfit += self._bend * np.minimum(at - start, stop - at)
        is_free = self._is_disjoint[low, k] & self._is_disjoint[k, high] & (k > chosen[0])
        misfit = np.where(is_free, misfit, 0.0)
        self._worst, self.misfit = int(misfit.argmax()), float(misfit.max()) / self._edge


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
    while growing := [plan for plan in chosen if plan.can_add_loop and plan.sides <= most]:
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
    for limits in COLLAPSE_LIMITS:
        if len(cage.vertices) > count:
            collapser = _CollapserAround(cage, motion, evenness, limits, loops.vertex_count)
            cage = collapser.run(count)
    return cage


class _CollapserAround(Collapser):
    """A collapser that leaves the first vertices of a mesh, `fixed` ones, where they are."""

    def __init__(
        self,
        cage: TriMesh,
        motion: Motion | None,
        evenness: float,
        limits: CollapseLimits,
        fixed: int,
    ) -> None:
        self._fixed = fixed
        super().__init__(cage, motion, evenness, limits)

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


def _trace(sections: list[Floats], motion: Motion | None) -> Floats:
    """Return what a tube is to follow: centres in the rest pose and others, and radii.

    (p + 2, places, 3); a radius is the length of a vector.
    """
    centres = np.array([find_centre(section) for section in sections])
    poses = [] if motion is None else list(motion.carry(centres))
    radii = np.zeros_like(centres)
    radii[:, 0] = [measure_length(section) / (2 * np.pi) for section in sections]
    return np.array([centres, *poses, radii])


def _make_loops(sections: list[Floats], centres: Floats, ways: Floats, sides: int) -> Floats:
    """Return loops around sections, (places, sides, 3), in the turn in which they are smallest.

    They go counter-clockwise about the directions, and turn about them as little as can be. Their
    planes go through the centres.
    """
    across = _turn_along(ways)
    axes = np.stack([across, np.cross(ways, across)], axis=1)
    found = [
        _circumscribe((section.reshape(-1, 3) - centre) @ plane.T, sides)
        for section, centre, plane in zip(sections, centres, axes, strict=True)
    ]
    corners = np.array([corners for corners, _ in found])
    best = np.sum([areas for _, areas in found], axis=0).argmin()
    return np.asarray(centres[:, None] + corners[:, best] @ axes)


def _turn_along(ways: Floats) -> Floats:
    """Return unit vectors across directions, (k, 3), each the last one turned with them."""
    across = np.empty_like(ways)
    side = np.eye(3)[np.abs(ways[0]).argmin()]
    for k, way in enumerate(ways):
        side = side - (side @ way) * way
        across[k] = side = side / np.linalg.norm(side)
    return across


def _circumscribe(points: Floats, sides: int) -> tuple[Floats, Floats]:
    """Return polygons of equal angles around points, (k, 2), in `LOOP_TURNS` turns.

    Returns
    -------
    (t, sides, 2), (t,)
        Corners, counter-clockwise, and areas.
    """
    angle = 2 * np.pi / sides
    turns = angle * (np.arange(sides) + np.arange(LOOP_TURNS)[:, None] / LOOP_TURNS)
    normals = np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    along = np.stack([-np.sin(turns), np.cos(turns)], axis=-1)
    reach = (normals @ points.T).max(axis=2)
    following = np.roll(reach, -1, axis=1)
    # Where a side meets the next one, which is turned by the angle.
    far = (following - reach * np.cos(angle)) / np.sin(angle)
    corners = reach[..., None] * normals + far[..., None] * along
    x, y = corners[..., 0], corners[..., 1]
    areas = (x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1) / 2
    return corners, areas


def find_border(faces: Integers) -> Integers | None:
    """Return the vertices around faces, (b,), in their direction; None if they are no disk."""
    border: Integers = igl.boundary_loop(faces)
    edges = Edges.from_faces(faces)
    is_one_border = len(border) == np.count_nonzero(edges.face_counts == 1)
    if not is_one_border or len(np.unique(faces)) - len(edges.ends) + len(faces) != 1:
        return None
    sides = {tuple(side) for k in range(3) for side in faces[:, [k, k - 2]].tolist()}
    return border if tuple(border[:2].tolist()) in sides else border[::-1].copy()
