"""Loops of a few vertices around the limbs of a cage, more where they bend: faces follow them.

The limbs of a fine shell are replaced by coarse tubes of quads, whose loops go around sections of
the limb, apart from each other. The rest is decimated around them. The vertices of loops are the
first ones of a cage.
"""

from dataclasses import dataclass

import igl
import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from cageik_cli.cages.builder.collapse import Motion
from cageik_cli.cages.builder.draft import Edge, name_edge
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

MIN_LIMB_LENGTH = 0.06
"""How far a limb goes, in diagonals, at least."""

MIN_LIMB_SLENDERNESS = 1.1
"""The length of a limb over its mean width, at least."""

BASE_MARGIN = 0.05
"""What part of a limb is left between its base and what it meets, which may be another limb."""

MAX_DEPTH_SOURCES = 100
"""Vertices from which distances over a shell are measured, at most."""

DEPTH_SMOOTHINGS = 3
"""How often depths are averaged with those beside them: distances along edges are uneven."""

LINE_POINTS = 24
"""Points of the centre line of a limb."""


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


class CentreLine:
    """A polyline that goes on straight at both ends. Heights are lengths along it from its start.

    Parameters
    ----------
    points : (j, 3) float64
    """

    def __init__(self, points: Floats) -> None:
        self._points, self._sides = points[:-1], np.diff(points, axis=0)
        self._lengths = np.linalg.norm(self._sides, axis=1)
        self._starts = np.concatenate([[0], np.cumsum(self._lengths)[:-1]])

    def measure_heights(self, points: Floats) -> Floats:
        """Return the heights of the places on the line that are nearest to points, (k,)."""
        between = points[:, None] - self._points
        share = (between * self._sides).sum(axis=2) / self._lengths**2
        low, high = np.zeros(len(self._sides)), np.ones(len(self._sides))
        low[0], high[-1] = -np.inf, np.inf
        share = np.clip(share, low, high)
        away = np.linalg.norm(between - share[..., None] * self._sides, axis=2)
        heights = self._starts + share * self._lengths
        return np.asarray(heights[np.arange(len(points)), away.argmin(axis=1)])

    def place(self, heights: Floats) -> Floats:
        """Return places on the line, (k, 3)."""
        k = np.clip(np.searchsorted(self._starts, heights) - 1, 0, len(self._sides) - 1)
        share = (heights - self._starts[k]) / self._lengths[k]
        return np.asarray(self._points[k] + share[:, None] * self._sides[k])

    def find_directions(self, heights: Floats, step: float) -> Floats:
        """Return unit directions of the line, (k, 3), between places a step below and above."""
        ways = self.place(heights + step) - self.place(heights - step)
        return np.asarray(ways / np.linalg.norm(ways, axis=1, keepdims=True))


class Limb:
    """A part of a shell up to a tip.

    Parameters
    ----------
    members : (k,) int64
        Vertices of the shell.
    depth : (m,) float64
        Of all vertices: its level sets go around the limb.

    Attributes
    ----------
    line : CentreLine
    beyond : (k,) int64
        The vertices beyond the base.
    base, tip : float
        The heights between which its sections are closed.
    diameter : float
        Mean, from the girths.
    """

    def __init__(self, shell: TriMesh, members: Integers, depth: Floats) -> None:
        self._shell = shell
        self._faces = shell.faces[np.isin(shell.faces, members).any(axis=1)]
        levels = np.linspace(depth[members].min(), depth[members].max(), 2 * LINE_POINTS + 1)[1::2]
        centres = np.array([find_centre(part) for part in self._cut(depth, levels) if len(part)])
        for _ in range(2):
            centres[1:-1] = (centres[:-2] + 2 * centres[1:-1] + centres[2:]) / 4
        self.line = CentreLine(centres)
        self._heights = self.line.measure_heights(shell.vertices)
        border = float(self._heights[np.setdiff1d(self._faces, members)].max())
        self.tip = float(self._heights[members].max())
        self.base = border + BASE_MARGIN * (self.tip - border)
        self.beyond = members[self._heights[members] > self.base]
        middle = np.linspace(self.base, self.tip, 9)[1:-2]
        sections = [part for part in self._cut(self._heights, middle) if len(part)]
        self.diameter = float(np.mean([measure_length(part) for part in sections]) / np.pi)
        radii = [np.linalg.norm(part - find_centre(part), axis=2).max() for part in sections]
        self._width = 2 * float(np.mean(radii))

    @property
    def is_slender(self) -> bool:
        """Return whether it is a limb rather than a bump."""
        least = max(MIN_LIMB_LENGTH, MIN_LIMB_SLENDERNESS * self._width)
        return self.tip - self.base >= least

    def cut(self, heights: Floats) -> list[Floats]:
        """Return the segments of the sections at heights, (s, 2, 3) each."""
        return self._cut(self._heights, heights)

    def _cut(self, values: Floats, levels: Floats) -> list[Floats]:
        points, ends, level = igl.isolines(self._shell.vertices, self._faces, values, levels)
        return [points[ends[level == k]] for k in range(len(levels))]


def measure_length(segments: Floats) -> float:
    """Return the total length of segments (s, 2, 3)."""
    return float(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum())


def find_centre(segments: Floats) -> Floats:
    """Return the centre of the length of segments (s, 2, 3)."""
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    return np.asarray(lengths @ segments.mean(axis=1) / max(lengths.sum(), 1e-300))


def find_limbs(shell: TriMesh) -> list[Limb]:
    """Find the limbs of a shell, the thinnest first.

    The depth of a place is its mean distance over the surface from all of the shell (Hilaga et al.
    2001): it is least in the middle of the shell, and equal all around a limb.
    """
    ends, count = shell.edges.ends, len(shell.vertices)
    lengths = np.linalg.norm(shell.vertices[ends[:, 0]] - shell.vertices[ends[:, 1]], axis=1)
    graph = sparse.csr_array((lengths, (ends[:, 0], ends[:, 1])), shape=(count, count))
    graph = sparse.csr_array(graph + graph.T)
    sources = np.arange(0, count, -(-count // MAX_DEPTH_SOURCES))
    depth = dijkstra(graph, indices=sources).mean(axis=0)
    beside = sparse.csr_array(graph > 0, dtype=np.float64)
    degree = beside.sum(axis=1)
    for _ in range(DEPTH_SMOOTHINGS):
        depth = (depth + (beside @ depth) / degree) / 2
    limbs = [Limb(shell, members, depth) for members in _find_branches(shell, depth)]
    return sorted((limb for limb in limbs if limb.is_slender), key=lambda limb: limb.diameter)


def _find_branches(shell: TriMesh, depth: Floats) -> list[Integers]:
    """Return the vertices of each branch of the join tree of depths that ends in a tip.

    Vertices are added from the deepest. A branch grows until it meets another, where both are
    longer than `MIN_LIMB_LENGTH`; shorter ones are part of what they meet.
    """
    around: list[list[int]] = [[] for _ in depth]
    for a, b in shell.edges.ends.tolist():
        around[a].append(b)
        around[b].append(a)
    branch = np.full(len(depth), -1)  # numbered by the tip
    members: dict[int, list[int]] = {}
    joined: set[int] = set()
    found: list[list[int]] = []
    for vertex in np.argsort(-depth, kind="stable").tolist():
        meeting = set(branch[around[vertex]].tolist()) - {-1}
        first, *others = sorted(meeting, key=lambda tip: -depth[tip]) or [vertex]
        long = [tip for tip in meeting if depth[tip] - depth[vertex] >= MIN_LIMB_LENGTH]
        if len(long) > 1:
            found += [list(members[tip]) for tip in sorted(long) if tip not in joined]
            joined.add(first)
        elif meeting & joined:
            joined.add(first)
        for tip in others:
            branch[members[tip]] = first
            members[first] += members.pop(tip)
        branch[vertex] = first
        members.setdefault(first, []).append(vertex)
    return [np.array(branch) for branch in found]


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
    across, side = np.empty_like(ways), np.eye(3)[np.abs(ways[0]).argmin()]
    for k, way in enumerate(ways):  # each the last one turned with them
        side = side - (side @ way) * way
        across[k] = side = side / np.linalg.norm(side)
    axes = np.stack([across, np.cross(ways, across)], axis=1)
    found = [
        _circumscribe((section.reshape(-1, 3) - centre) @ plane.T, sides)
        for section, centre, plane in zip(sections, centres, axes, strict=True)
    ]
    corners = np.array([corners for corners, _ in found])
    best = np.sum([areas for _, areas in found], axis=0).argmin()
    return np.asarray(centres[:, None] + corners[:, best] @ axes)


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
        faces.append(_join_rings(places, border, tube[0]))
        # Between the loops, and over the last one.
        low, high, end = tube[:-1], tube[1:], tube[-1]
        low_next, high_next = (np.roll(rings, -1, axis=1) for rings in (low, high))
        faces.append(np.stack([low, low_next, high_next], axis=-1).reshape(-1, 3))
        faces.append(np.stack([low, high_next, high], axis=-1).reshape(-1, 3))
        faces.append(np.stack([np.repeat(end[0], len(end) - 2), end[1:-1], end[2:]], axis=1))
        tubes.append(tube)
    return TriMesh(places, np.concatenate(faces)), Loops(tuple(tubes))


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
