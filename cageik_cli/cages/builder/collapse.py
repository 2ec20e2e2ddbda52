"""Decimation that keeps faces in shape, with quadrics summed over poses.

Garland and Heckbert 1997; for animations Mohr and Gleicher 2003: without poses, or with none that
differ, the two are one.
"""

import heapq
from collections.abc import Callable
from typing import Any, NamedTuple

import igl
import numpy as np

from cageik_cli.cages.builder.motion import Motion
from cageik_cli.geometry.mesh import TriMesh
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


class CollapseLimits(NamedTuple):
    """What collapses leave.

    Attributes
    ----------
    angle : float
        Degrees that faces keep, unless they had less.
    valence : int
        Edges at a vertex, at most.
    cosine : float
        Between the normals of a face before and after, at least.
    """

    angle: float
    valence: int
    cosine: float


COLLAPSE_LIMITS = tuple(
    CollapseLimits(*row) for row in ((6.0, 10, 0.2), (3.0, 11, 0.0), (0.5, 14, -0.3))
)
"""Each is for what collapses within those before cannot do."""


def collapse_edges(
    cage: TriMesh, count: int, motion: Motion | None, evenness: float = MIN_EVENNESS
) -> TriMesh:
    """Collapse edges until there are `count` vertices, or none is left that may be collapsed.

    The cost of a collapse is the sum over the rest pose and those of the motion, each with its own
    best place, so that vertices stay where any pose bends.
    """
    for limits in COLLAPSE_LIMITS:
        if len(cage.vertices) > count:
            cage = Collapser(cage, motion, evenness, limits).run(count)
    return cage


class Collapser:
    """A mesh in all poses, its quadrics, and a queue of the collapses that are possible."""

    def __init__(
        self, cage: TriMesh, motion: Motion | None, evenness: float, limits: CollapseLimits
    ) -> None:
        self._evenness, self._limits = evenness, limits
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
        costs, targets = self._weigh(ends)
        for (a, b), cost, target in zip(ends.tolist(), costs.tolist(), targets, strict=True):
            item = (cost, a, b, int(self._age[a]), int(self._age[b]), len(self._targets))
            heapq.heappush(self._queue, item)
            self._targets.append(target)

    def _weigh(self, ends: Integers) -> tuple[Floats, Floats]:
        """Return the costs of collapses, (e,), and the best places in all poses, (e, p, 3)."""
        return collapse_costs(self._quadrics, self._places, ends, self._evenness)

    def _collapse(self, a: int, b: int, places: Floats) -> None:
        """Merge b into a if the surface stays manifold and its faces keep their shape.

        `places` (p, 3) is where the vertex goes in the poses.
        """
        if self._stays_manifold(a, b) and self._keeps_shape(a, b, places[0]):
            self._merge(a, b, places)

    def _stays_manifold(self, a: int, b: int) -> bool:
        """Return whether a merge leaves a manifold, and no vertex with too many edges."""
        common = self._around[a] & self._around[b]
        valence = len(self._around[a]) + len(self._around[b]) - 4
        if len(common) != 2 or min(len(self._around[c]) for c in common) <= 3:
            return False
        return valence <= self._limits.valence

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
        if (cosine < self._limits.cosine * lengths[0] * lengths[1]).any() or lengths[1].min() == 0:
            return False
        angle = measure_angles(moved).min()
        return bool(angle >= self._limits.angle or angle >= measure_angles(old).min())

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
