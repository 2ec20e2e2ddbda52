"""Fewer joints: two by two, those are merged that cost least.

If the vertices x_i of a joint follow it rigidly in all frames, the sum of squares is

    E = Σ_f min_{R,t} Σ_i |x_i R + t − v_fi|²
      = Σ_f (Σ_i |x_i − x̄|² + Σ_i |v_fi − v̄_f|² − 2 Σ_k ±σ_k(C_f)),
    C_f = Σ_i (x_i − x̄)ᵀ (v_fi − v̄_f),

the last singular value with the sign of the determinant (Kabsch 1976). It needs only sums over the
vertices, and those of a merged joint are the sums of both. So joints that are neighbours in the
cage are merged greedily by how much E grows (Ward 1963). The order of merges is a tree, and each
number of joints is a cut through it: few joints for a budget, and fewer still as limbs.

A vertex is counted for its strongest joint alone. On a dancer and 24 joints, weights as shares
give cuts whose error is 13 % larger.

The parts of a cut are made of whole joints of the cage, which need not end where the motion does.
So each vertex then goes to the joint whose rigid motion is nearest to its own, and the motions are
those of the new parts, a few times (Lloyd 1982; Le and Deng 2012, section 3.2).
"""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.rotations import nearest_rotations_by_svd
from cageik_cli.method.weights.binding import Binding
from cageik_cli.util.arrays import Floats, Integers

COMPACTNESS = 1e-3
"""A merge that spreads a joint costs this share of the spread, so that a rigid body has parts."""

MIN_JOINTS = 3
"""Joints of a skin, at least: they have the faces of a mesh."""

REGROUPINGS = 5
"""Vertices go to the joint that moves as they do so many times; 15 have hardly less error."""

MAX_LIMBS = 12
"""Limbs that joints are grouped in, at most: parts of the body, also a trunk."""

MIN_JOINTS_PER_LIMB = 4
"""Joints that a limb has on average, at least."""


class JointTree:
    """The joints of a skin, and the order in which they are merged.

    Parameters
    ----------
    weights : (m, n) float64
        Zero for vertices that do not count.
    rest : (m, 3) float64
    blocks : iterable of (m, 3k) float64
        Displacements of frames from the rest pose. Each frame is scaled by the root of how much
        it counts, and may be turned as a whole.
    scales : (F,) float64
        Those roots.
    edges : (e, 2) int64
        Joints that may be merged; where none are left, any may.
    """

    def __init__(
        self,
        weights: Floats,
        rest: Floats,
        blocks: Iterable[Floats],
        scales: Floats,
        edges: Integers,
    ) -> None:
        self.count = weights.shape[1]
        self._sums = _sum_moments(weights, rest, blocks, scales)
        self._costs = self._measure(self._sums)
        self._merges = self._merge_all({(int(a), int(b)) for a, b in np.sort(edges, axis=1)})

    def cut(self, count: int) -> Integers:
        """Return which of `count` joints each becomes, (n,): numbered by their first vertices."""
        labels = np.arange(self.count)
        for kept, merged in self._merges[: self.count - count]:
            labels[labels == merged] = kept
        return np.unique(labels, return_inverse=True)[1]

    def group_limbs(
        self, joints: Integers | None = None, count: int | None = None
    ) -> Integers | None:
        """Return the limb of each of N joints, (N,); None if there are too few.

        `joints`, (n,), is a cut through the tree; all joints if absent. There are `count` limbs, or
        those of `count_limbs`.
        """
        held = np.arange(self.count) if joints is None else joints
        first = np.unique(held, return_index=True)[1]
        count = count or count_limbs(len(first))
        return self.cut(count)[first] if count else None  # a limb has whole joints

    def _merge_all(self, edges: set[tuple[int, int]]) -> list[tuple[int, int]]:
        """Merge until one joint is left; the larger number of each pair becomes the smaller."""
        alive = set(range(self.count))
        growth: dict[tuple[int, int], float] = {}
        self._measure_merges(growth, edges)
        merges = []
        while len(alive) > 1:
            if not growth:
                self._measure_merges(growth, {(a, b) for a in alive for b in alive if a < b})
            kept, gone = min(growth, key=lambda pair: (growth[pair], pair))
            merges.append((kept, gone))
            alive.remove(gone)
            self._sums[kept] += self._sums[gone]
            self._costs[kept] = self._measure(self._sums[[kept]])[0]
            touched = {pair for pair in growth if kept in pair or gone in pair}
            for pair in touched:
                del growth[pair]
            others = {end for pair in touched for end in pair} - {kept, gone}
            self._measure_merges(growth, {(min(kept, k), max(kept, k)) for k in others})
        return merges

    def _measure_merges(
        self, growth: dict[tuple[int, int], float], pairs: set[tuple[int, int]]
    ) -> None:
        """Note by how much the merges of `pairs` make the sum of squares grow."""
        for first in range(0, len(pairs), 256):
            block = np.array(sorted(pairs)[first : first + 256])
            together = self._measure(self._sums[block[:, 0]] + self._sums[block[:, 1]])
            found = together - self._costs[block[:, 0]] - self._costs[block[:, 1]]
            growth.update(zip(map(tuple, block.tolist()), found.tolist(), strict=True))

    @staticmethod
    def _measure(sums: Floats) -> Floats:
        """Return the cost of joints, (p,), from their sums, (p, F, 18)."""
        mass = np.maximum(sums[:, :, 0], np.finfo(float).tiny)
        first, moved = sums[:, :, 1:4], sums[:, :, 4:7]
        cross = sums[:, :, 7:16].reshape(*mass.shape, 3, 3)
        cross = cross - first[..., :, None] * moved[..., None, :] / mass[..., None, None]
        spread = sums[:, :, 16] - np.square(first).sum(axis=2) / mass
        moved_spread = sums[:, :, 17] - np.square(moved).sum(axis=2) / mass
        values = np.linalg.svd(cross, compute_uv=False)
        values[..., 2] *= np.sign(np.linalg.det(cross))
        cost = spread + moved_spread - 2 * values.sum(axis=2)
        return np.asarray((cost + COMPACTNESS * spread).sum(axis=1))


def count_limbs(count: int) -> int:
    """Return how many limbs `count` joints are grouped in, at most; 0 if they are too few."""
    limbs = min(MAX_LIMBS, count // MIN_JOINTS_PER_LIMB)
    return limbs if limbs > 1 else 0


def split_budget(budget: int, count: int, heads: int) -> tuple[int, int]:
    """Return how many of `budget` joints turn with the mesh, and how many are limbs.

    The cage has `count` vertices; `heads` joints are above all. Limbs make room first, as they add
    nothing to what the mesh can do; only then are joints merged.
    """
    turning = min(count, budget - heads)
    return turning, budget - heads - turning


def merge_joints(binding: Binding, joints: Integers) -> Binding:
    """Return a binding to N joints, of which each vertex of the cage becomes one, (n,).

    Its cage has the joints as vertices, at the centre of what follows them, and the faces between
    three of them; if there are none, a strip of all. A joint of one vertex stays where that is.
    """
    count = int(joints.max()) + 1
    chosen = np.eye(count)[joints]
    weights = binding.weights @ chosen
    sizes = chosen.sum(axis=0)[:, None]
    followers = np.maximum(weights, 0) * binding.rest.is_used[:, None]
    mass = followers.sum(axis=0)[:, None]
    centres = followers.T @ binding.rest.vertices / np.where(mass > 0, mass, 1)
    own = chosen.T @ binding.cage.vertices / sizes
    places = np.where((sizes == 1) | (mass == 0), own, centres)
    faces = joints[binding.cage.faces]
    first, second, third = faces.T
    kept = faces[(first != second) & (second != third) & (third != first)]
    strip = np.arange(count - 2)[:, None] + np.arange(3)
    cage = TriMesh(places, kept if len(kept) else strip)
    return replace(binding, cage=cage, weights=weights, has_offsets=True)


def regroup_vertices(
    binding: Binding, rest: Floats, blocks: Callable[[], Iterable[Floats]], scales: Floats
) -> Binding:
    """Return a binding in which each vertex follows the joint that moves as it does by half.

    The other half are the weights before: a joint that is nearest to no vertex keeps some. Joints
    are in the middle of what is nearest to them. Frames are as of `JointTree`.
    """
    n, size = binding.weights.shape[1], float(np.abs(rest).max()) or 1.0
    x, is_used = rest / size, binding.rest.is_used
    owners = binding.weights.argmax(axis=1)
    for _ in range(REGROUPINGS):
        sums = _sum_moments(np.eye(n)[owners] * is_used[:, None], rest, blocks(), scales)
        mass = np.maximum(sums[:, :, :1], np.finfo(float).tiny)
        middle, moved = sums[:, :, 1:4] / mass, sums[:, :, 4:7] / mass
        cross = sums[:, :, 7:16].reshape(*mass.shape[:2], 3, 3)
        cross = cross - sums[:, :, 1:4, None] * moved[:, :, None]
        turns = nearest_rotations_by_svd(cross.reshape(-1, 3, 3)).reshape(cross.shape)
        shifts = moved - np.einsum("nfa,nfab->nfb", middle, turns)
        squares = np.square(scales)
        costs = np.einsum("f,nfb,nfb->n", squares, shifts, shifts)
        costs = costs + 2 * x @ np.einsum("f,nfab,nfb->an", squares, turns, shifts)
        done = 0
        for block in blocks():
            chosen = slice(done, done + block.shape[1] // 3)
            done = chosen.stop
            shares = np.repeat(scales[chosen], 3)
            places = (block / size + np.tile(x, done - chosen.start) * shares) * shares
            for axis in range(3):
                costs -= 2 * x[:, axis, None] * (places @ turns[:, chosen, axis].reshape(n, -1).T)
            costs -= 2 * places @ shifts[:, chosen].reshape(n, -1).T
        costs[:, ~sums[:, :, 0].any(axis=1)] = np.inf
        owners = costs.argmin(axis=1)
    followers = np.eye(n)[owners] * is_used[:, None]
    mass = followers.sum(axis=0)[:, None]
    centres = followers.T @ binding.rest.vertices / np.maximum(mass, 1)
    cage = binding.cage.move(np.where(mass > 0, centres, binding.cage.vertices))
    return replace(binding, cage=cage, weights=(np.eye(n)[owners] + binding.weights) / 2)


def _sum_moments(weights: Floats, rest: Floats, blocks: Iterable[Floats], scales: Floats) -> Floats:
    """Return sums over the vertices of each joint, (n, F, 18).

    They are of 1, x, v, xᵀv, |x|² and |v|², in this order, times how much the frame counts.
    """
    from scipy import sparse

    m, n = weights.shape
    places = weights.argmax(axis=1), np.arange(m)
    gather = sparse.csr_array((weights.any(axis=1).astype(np.float64), places), shape=(n, m))
    size = float(np.abs(rest).max()) or 1.0
    rest = rest / size
    still = gather @ np.column_stack([np.ones(m), rest, np.square(rest).sum(axis=1)])
    found, done = np.empty((n, len(scales), 18)), 0
    for block in blocks:
        chosen = slice(done, done + block.shape[1] // 3)
        count = len(scales[chosen])
        moved = block / size / np.repeat(scales[chosen], 3) + np.tile(rest, count)
        sums = found[:, chosen]
        sums[:, :, :4], sums[:, :, 16] = still[:, None, :4], still[:, 4:]
        sums[:, :, 4:7] = (gather @ moved).reshape(n, count, 3)
        for axis in range(3):
            columns = slice(7 + 3 * axis, 10 + 3 * axis)
            along = gather @ (rest[:, axis, None] * moved)
            sums[:, :, columns] = along.reshape(n, count, 3)
        sums[:, :, 17] = gather @ np.square(moved).reshape(m, count, 3).sum(axis=2)
        sums *= np.square(scales[chosen])[:, None]
        done += count
    return found
