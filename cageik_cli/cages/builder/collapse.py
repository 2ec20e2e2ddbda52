"""Decimation that keeps faces in shape, with quadrics summed over poses.

Garland and Heckbert 1997; for animations Mohr and Gleicher 2003: without poses, or with none that
differ, the two are one.
"""

import heapq
from collections.abc import Callable
from typing import Any

import igl
import numpy as np
from scipy.spatial import cKDTree

from cageik_cli.cages.builder.frame import MIN_PLANE_DISTANCE, add_image, take_half
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.points import choose_farthest
from cageik_cli.geometry.shape import cross, measure_angles
from cageik_cli.util.arrays import Floats, Integers

MIN_EVENNESS, ROUND_EVENNESS = 1e-4, 0.03
"""What the square of a length costs over that of a distance in a quadric, for shells that quadrics
keep in shape, and for round ones: more leaves edges that are more equal, and planes that fit less
well."""

NEEDLE_ANGLE, MAX_NEEDLE_SHARE = 5.0, 0.013
"""Which share of the faces of a thinned shell may have an angle below this, degrees: characters and
balls have up to 0.004 of them, sheets and cones 0.011, tubes and boxes 0.016 to 0.4."""

MAX_SLIMMED_VERTICES = 10_000
"""Vertices of a shell from which quadrics thin it. Of twice as many or more, short edges are
collapsed first, in half the time, and the surface stays the same to 0.2 % of its volume."""

COLLAPSE_LIMITS = ((6.0, 10, 0.2), (3.0, 11, 0.0), (0.5, 14, -0.3))
"""What collapses leave: degrees that angles of faces keep, unless they had less; edges at a vertex,
at most; and the cosine between the normals of a face before and after, at least. Each row is for
what collapses within those before cannot do."""

POSE_TOL = 1e-9
"""Frames that differ by a smaller root mean square, in diagonals, are one pose: moves round."""


class Motion:
    """A model in its rest pose and in others, each moved rigidly onto the rest pose.

    Parameters
    ----------
    rest : (m, 3) float64
    frames : (k, m, 3) float64
        In any place.

    Attributes
    ----------
    poses : (p, m, 3) float64
        The frames that differ most from the rest pose and from each other.
    points : (s, 3) float64
        Some of the vertices, in the rest pose.
    displacements : (s, r) float64
        Displacements of these in all frames, reduced to their main directions: left singular
        vectors times their singular values.
    """

    def __init__(self, rest: Floats, frames: Floats) -> None:
        self._rest = rest
        # Each frame is moved rigidly onto the rest pose.
        centre = rest.mean(axis=0)
        centred = frames - frames.mean(axis=1, keepdims=True)
        turns = _find_turns(np.einsum("kmx,my->kxy", centred, rest - centre))
        aligned = np.einsum("kmx,kxy->kmy", centred, turns) + centre

        def measure(pose: Floats) -> Floats:
            squares = ((aligned - pose) ** 2).sum(axis=2).mean(axis=1)
            return np.where(squares > POSE_TOL**2, squares, 0.0)

        chosen = choose_farthest(min(8, len(frames)), measure(rest), lambda k: measure(aligned[k]))
        self.poses = aligned[chosen]
        step = max(1, -(-len(rest) // 1200))
        self.points = rest[::step]
        moves = (aligned[:, ::step] - self.points).transpose(1, 0, 2).reshape(len(self.points), -1)
        left, size, _ = np.linalg.svd(moves, full_matrices=False)
        self.displacements = left[:, :40] * size[:40]

    def carry(self, points: Floats) -> Floats:
        """Return where points beside the rest pose go in the poses, (p, n, 3).

        Each follows the best rigid motion of the model's vertices near it (Müller et al. 2005).
        """
        distance, near = cKDTree(self._rest).query(points, min(24, len(self._rest)))
        near = near.reshape(len(points), -1)
        # Vertices around that are no further than this, in diagonals, count about equally.
        weight = 1 / (distance.reshape(len(points), -1) + 0.01) ** 2
        weight /= weight.sum(axis=1, keepdims=True)
        source = self._rest[near]
        centre = np.einsum("pn,pnx->px", weight, source)
        spread = source - centre[:, None]
        carried = np.empty((len(self.poses), len(points), 3))
        for k, pose in enumerate(self.poses):
            target = pose[near]
            middle = np.einsum("pn,pnx->px", weight, target)
            turn = _find_turns(np.einsum("pn,pnx,pny->pxy", weight, spread, target))
            carried[k] = middle + np.einsum("px,pxy->py", points - centre, turn)
        return carried


def _find_turns(products: Floats) -> Floats:
    """Return the rotations R with rows x R nearest to y, from Σ xᵀy, (p, 3, 3) (Kabsch 1976)."""
    left, _, right = np.linalg.svd(products)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return np.asarray(left @ right)


def collapse_edges(
    cage: TriMesh,
    count: int,
    motion: Motion | None,
    evenness: float = MIN_EVENNESS,
    *,
    fixed: int = 0,
    axis: int | None = None,
) -> TriMesh:
    """Collapse edges until there are `count` vertices, or none is left that may be collapsed.

    The cost of a collapse is the sum over the rest pose and those of the motion, each with its own
    best place, so that vertices stay where any pose bends.

    Parameters
    ----------
    fixed : int
        So many vertices, the first ones, stay where they are.
    axis : int, optional
        That across the plane of a cage that is its own mirror image, and stays so; vertices are
        then `count`, or one less. Such a cage has no motion and no fixed vertices.
    """
    for limits in COLLAPSE_LIMITS:
        if len(cage.vertices) <= count:
            break
        if axis is None:
            cage = Collapser(cage, motion, evenness, limits, fixed).run(count)
        else:
            cage = add_image(_HalfCollapser(cage, axis, evenness, limits).run(count), axis)
    return cage


class Collapser:
    """A mesh in all poses, its quadrics, and a queue of the collapses that are possible.

    Parameters
    ----------
    limits : tuple
        A row of `COLLAPSE_LIMITS`.
    fixed : int
        So many vertices, the first ones, stay where they are.
    """

    def __init__(
        self,
        cage: TriMesh,
        motion: Motion | None,
        evenness: float,
        limits: tuple[float, int, float],
        fixed: int = 0,
    ) -> None:
        self._evenness, self._fixed = evenness, fixed
        self._min_angle, self._max_valence, self._min_cosine = limits
        carried = [] if motion is None else [motion.carry(cage.vertices)]
        self._places = np.concatenate([cage.vertices[None], *carried])
        self._quadrics = np.array([vertex_quadrics(TriMesh(p, cage.faces)) for p in self._places])
        self._around: list[set[int]] = [set() for _ in cage.vertices]
        self._faces = [tuple(face) for face in cage.faces.tolist()]
        self._at: list[set[int]] = [set() for _ in cage.vertices]
        for number, face in enumerate(self._faces):
            for vertex in face:
                self._at[vertex].add(number)
                self._around[vertex].update(other for other in face if other != vertex)
        self._left = len(cage.vertices)
        self._age = np.zeros(len(cage.vertices), np.int64)
        self._queue: list[tuple[float, int, int, int, int, int]] = []
        self._targets: list[Floats] = []  # best places in all poses, (p, 3), of what was queued
        self._push(cage.edges.ends)

    def run(self, count: int) -> TriMesh:
        """Collapse until there are `count` vertices."""
        while self._left > count and self._queue:
            _, a, b, age_a, age_b, target = heapq.heappop(self._queue)
            if (self._age[a], self._age[b]) == (age_a, age_b):
                self._collapse(a, b, self._targets[target])
        faces = np.array(sorted(set().union(*self._at)), np.int64)
        corners = np.array(self._faces, np.int64)[faces]
        used, corners = np.unique(corners, return_inverse=True)
        return TriMesh(self._places[0, used], corners.reshape(-1, 3))

    def _push(self, ends: Integers) -> None:
        """Queue the collapses of edges, (e, 2)."""
        ends = ends[ends.max(axis=1) >= self._fixed]
        costs, targets = self._weigh(ends)
        for (a, b), cost, target in zip(ends.tolist(), costs.tolist(), targets, strict=True):
            item = (cost, a, b, int(self._age[a]), int(self._age[b]), len(self._targets))
            heapq.heappush(self._queue, item)
            self._targets.append(target)

    def _weigh(self, ends: Integers) -> tuple[Floats, Floats]:
        """Return the costs of collapses, (e,), and the best places in all poses, (e, p, 3)."""
        costs, targets = collapse_costs(self._quadrics, self._places, ends, self._evenness)
        if self._fixed:
            is_fixed = ends < self._fixed
            one = is_fixed.any(axis=1)
            targets[one] = self._places[:, ends[is_fixed]].transpose(1, 0, 2)
            total = self._quadrics[:, ends[one]].sum(axis=2)
            places = np.concatenate([targets[one], np.ones((*targets[one].shape[:2], 1))], axis=2)
            costs[one] = np.einsum("epi,peij,epj->e", places, total, places)
        return costs, targets

    def _collapse(self, a: int, b: int, places: Floats) -> None:
        """Merge b into a if the surface stays manifold and its faces keep their shape.

        `places` (p, 3) is where the vertex goes in the poses. Of two, a fixed one is left.
        """
        if b < self._fixed:
            a, b = b, a
        if self._stays_manifold(a, b) and self._keeps_shape(a, b, places[0]):
            self._merge(a, b, places)

    def _stays_manifold(self, a: int, b: int) -> bool:
        """Return whether a merge leaves a manifold, and no vertex with too many edges."""
        common = self._around[a] & self._around[b]
        valence = len(self._around[a]) + len(self._around[b]) - 4
        if len(common) != 2 or min(len(self._around[c]) for c in common) <= 3:
            return False
        return valence <= self._max_valence

    def _keeps_shape(self, a: int, b: int, place: Floats) -> bool:
        """Return whether faces neither turn over nor become needles in the rest pose."""
        left = sorted(self._at[a] ^ self._at[b])
        before = np.array([self._faces[f] for f in left])
        after = np.where(before == b, a, before)
        vertices = self._places[0]
        old = vertices[before]
        moved = np.where((after == a)[:, :, None], place, vertices[after])
        normals = [cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]) for t in (old, moved)]
        lengths = [np.linalg.norm(normal, axis=1) for normal in normals]
        cosine = (normals[0] * normals[1]).sum(axis=1)
        if (cosine < self._min_cosine * lengths[0] * lengths[1]).any() or lengths[1].min() == 0:
            return False
        angle = measure_angles(moved).min()
        return bool(angle >= self._min_angle or angle >= measure_angles(old).min())

    def _merge(self, a: int, b: int, places: Floats) -> None:
        self._left -= 1
        self._places[:, a] = places
        self._quadrics[:, a] += self._quadrics[:, b]
        for number in self._at[a] & self._at[b]:
            for vertex in self._faces[number]:
                self._at[vertex].discard(number)
        for number in self._at[b]:
            self._faces[number] = tuple(a if v == b else v for v in self._faces[number])
        self._at[a] |= self._at[b]
        self._at[b] = set()
        for other in self._around[b]:
            self._around[other].discard(b)
            if other != a:
                self._around[other].add(a)
                self._around[a].add(other)
        self._around[b] = set()
        self._age[[a, b]] += 1
        ring = sorted(self._around[a])
        self._push(np.array([[min(a, other), max(a, other)] for other in ring]))


class _HalfCollapser(Collapser):
    """The part of a cage above the plane where the coordinate of `axis` is 0; its border stays.

    The cage is its own mirror image to the last bit, and no edge crosses the plane: it is cut along
    edges on it. Vertices and edges are counted in the whole cage.
    """

    def __init__(
        self, cage: TriMesh, axis: int, evenness: float, limits: tuple[float, int, float]
    ) -> None:
        half = take_half(cage, axis)
        self._axis, self._on_plane = axis, half.vertices[:, axis] == 0
        super().__init__(half, None, evenness, limits)
        self._left = 2 * len(half.vertices) - int(self._on_plane.sum())

    def _weigh(self, ends: Integers) -> tuple[Floats, Floats]:
        costs, targets = super()._weigh(ends)
        count = self._on_plane[ends].sum(axis=1)
        if (at := count > 0).any():
            # Collapses onto the plane are weighed by quadrics that have no terms mixed with its
            # axis: those are the mean of a quadric and its mirror image.
            quadrics, places = self._quadrics[:, ends[at]], self._places[:, ends[at]]
            others = np.arange(4) != self._axis
            quadrics[..., self._axis, others] = quadrics[..., others, self._axis] = 0
            height = places[..., self._axis].max(axis=2)
            places[..., self._axis] = 0
            numbers = np.arange(2 * int(at.sum())).reshape(-1, 2)
            flat = (quadrics.reshape(1, -1, 4, 4), places.reshape(1, -1, 3))
            costs[at], targets[at] = collapse_costs(*flat, numbers, self._evenness)
            size = np.trace(quadrics.sum(axis=2)[..., :3, :3], axis1=2, axis2=3)
            targets[at, :, self._axis] = 0
            costs[at] += (self._evenness * size * height**2).sum(axis=0)
        # What a pair of vertices costs is that of one, twice: on the plane only one is saved.
        return np.where(count == 2, 2 * costs, costs), targets

    def _collapse(self, a: int, b: int, places: Floats) -> None:
        if self._on_plane[b]:
            a, b = b, a
        if self._on_plane[a] or places[0, self._axis] > MIN_PLANE_DISTANCE:
            super()._collapse(a, b, places)

    def _stays_manifold(self, a: int, b: int) -> bool:
        """Return whether a merge leaves a manifold, seen in the whole cage."""
        common = self._around[a] & self._around[b]
        is_border = self._on_plane[b]
        if len(common) != (1 if is_border else 2):
            return False
        ring = (self._around[a] | self._around[b]) - {a, b}
        if self._on_plane[a] and self._count_on_plane(ring) != 2:
            return False  # an edge that crosses the plane, or lies on it twice
        if min(self._count_edges(c, self._around[c]) for c in common) <= 3:
            return False
        return self._count_edges(a, ring) <= self._max_valence

    def _count_on_plane(self, vertices: set[int]) -> int:
        return int(self._on_plane[list(vertices)].sum())

    def _count_edges(self, vertex: int, ring: set[int]) -> int:
        """Return edges of the whole cage at a vertex, by the ring of its neighbours in the half."""
        on_plane = self._count_on_plane(ring)
        return 2 * len(ring) - on_plane if self._on_plane[vertex] else len(ring)

    def _merge(self, a: int, b: int, places: Floats) -> None:
        self._left -= 0 if self._on_plane[b] else 1
        super()._merge(a, b, places)


def vertex_quadrics(mesh: TriMesh) -> Floats:
    """Sum area times p pᵀ over the faces at each vertex, p the plane of the face, (n, 4, 4)."""
    corners = mesh.vertices[mesh.faces]
    normal = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.linalg.norm(normal, axis=1, keepdims=True)
    normal /= np.maximum(double, 1e-300)
    plane = np.concatenate([normal, -(normal * corners[:, 0]).sum(axis=1, keepdims=True)], axis=1)
    quadric = double[:, :, None] / 2 * plane[:, :, None] * plane[:, None]
    quadrics = np.zeros((len(mesh.vertices), 4, 4))
    for k in range(3):
        np.add.at(quadrics, mesh.faces[:, k], quadric)
    return quadrics


def collapse_costs(
    quadrics: Floats, places: Floats, ends: Integers, evenness: float = MIN_EVENNESS
) -> tuple[Floats, Floats]:
    """Return the cost of every collapse, summed over poses, and its best places in them.

    Parameters
    ----------
    quadrics : (p, n, 4, 4) float64
    places : (p, n, 3) float64
        Of the vertices.
    ends : (e, 2) int64
        Vertices that are merged.

    Returns
    -------
    (e,), (e, p, 3)
    """
    total = quadrics[:, ends[:, 0]] + quadrics[:, ends[:, 1]]
    start, stop = places[:, ends[:, 0]], places[:, ends[:, 1]]
    middle, length = (start + stop) / 2, np.linalg.norm(start - stop, axis=2)
    # Where the planes leave a direction open, the middle decides it.
    size = np.trace(total[..., :3, :3], axis1=2, axis2=3)
    matrix = total[..., :3, :3] + (1e-3 * size + 1e-30)[..., None, None] * np.eye(3)
    side = total[..., :3, 3] + (total[..., :3, :3] @ middle[..., None])[..., 0]
    step = -np.linalg.solve(matrix, side[..., None])[..., 0]
    reach = np.linalg.norm(step, axis=2)
    step *= np.minimum(1, length / np.maximum(reach, 1e-300))[..., None]
    targets = np.concatenate([middle + step, np.ones((*reach.shape, 1))], axis=2)
    costs = np.einsum("pei,peij,pej->pe", targets, total, targets) + evenness * size * length**2
    return costs.sum(axis=0), targets[..., :3].transpose(1, 0, 2)


def euler_characteristic(mesh: TriMesh) -> int:
    """Return V − E + F: 2 − 2 genus of a closed surface of one component."""
    return len(mesh.vertices) - len(mesh.edges.ends) + len(mesh.faces)


def list_stages(count: int) -> list[int]:
    """Return vertex counts of the stages from a fine shell down to `count`.

    Each leaves 0.6 of the vertices; the first has four times `count`, at least.
    """
    counts = [float(count)]
    while counts[-1] < 4 * count:
        counts.append(counts[-1] / 0.6)
    return [int(np.ceil(stage)) for stage in counts[::-1]]


def simplify_shell(shell: TriMesh, count: int) -> tuple[TriMesh, float]:
    """Thin a shell to `count` vertices by libigl's quick collapses, which are not tested.

    Quadrics leave needles along tubes and straight edges, which no later collapse can mend: the
    shortest edges are collapsed there instead, and the rest is to be even, too.

    Returns
    -------
    TriMesh
        The shell itself, if it has hardly more vertices.
    float
        The evenness to go on with.
    """
    if len(shell.vertices) <= 1.5 * count:
        return shell, MIN_EVENNESS
    if len(shell.vertices) > 2 * MAX_SLIMMED_VERTICES:
        shell = _collapse_quickly(igl.decimate, shell, MAX_SLIMMED_VERTICES)
    thin = _collapse_quickly(igl.qslim, shell, count)
    angles = measure_angles(thin.vertices[thin.faces]).min(axis=1)
    if (angles < NEEDLE_ANGLE).mean() <= MAX_NEEDLE_SHARE:
        return thin, MIN_EVENNESS
    return _collapse_quickly(igl.decimate, shell, count), ROUND_EVENNESS


def _collapse_quickly(collapse: Callable[..., Any], shell: TriMesh, count: int) -> TriMesh:
    faces = 2 * (count - euler_characteristic(shell))
    vertices, corners, *_ = collapse(
        np.asfortranarray(shell.vertices), np.asfortranarray(shell.faces.astype(np.int32)), faces
    )
    used, corners = np.unique(corners, return_inverse=True)
    return TriMesh(vertices[used], corners.reshape(-1, 3))
