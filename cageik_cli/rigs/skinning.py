"""Weights of few joints that turn, fitted to frames: by turns with the joints.

For given joints, each vertex has least squares of its own over the weights of its K joints. With
u_j where joint j alone would take the vertex, in all frames one after the other, and its normal,

    minimise  ω |d − Σ_j w_j u_j|²/s + λ |w − t|²      over w ≥ 0, Σ_j w_j = 1,

with t the mean of the row and of the mean of its neighbours, as in `fit.alternate`. A vertex has
few joints, and so the minimum is found exactly, by active sets (Nocedal and Wright 2006, algorithm
16.3). All vertices of a block take their steps together.

Which joints those are is chosen again in each round: beside its own, a vertex may have those which
alone come nearest. If more than K of them have a weight at the minimum, the one is dropped which
costs least, until K are left.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cageik_cli.fit.alternate import Alternator, CageSolve, Influences
from cageik_cli.fit.problem import ROUNDING_TOL, Displacements, WeightProblem, count_columns
from cageik_cli.method.weights.binding import Binding
from cageik_cli.rigs.joints import MAX_ROW_ENTRIES, JointSolver
from cageik_cli.rigs.merging import JointTree, merge_joints, regroup_vertices
from cageik_cli.util.arrays import Floats, Integers, Mask
from cageik_cli.util.threads import OrderedMap

REGULARIZATION = 3e-3
"""Weights have a λ this small: their frames have no noise that smooth weights would keep out."""

ROUNDS, MERGED_ROUNDS = 12, 20
"""Joints and weights take so many rounds; merged joints more, whose first weights fit worse.

Twice as many lower the error by another 5 to 8 %.
"""

SWEEPS_PER_ROUND = 3
"""In a round, joints move in turn so many times; the next one begins where they are."""

TRIED_JOINTS = 6
"""Joints that a vertex may have beside its own, in each round."""

MOVES_TOL, NORMALS_TOL = 1e-6, 1e-3
"""What fewer columns leave out of displacements and of changes of normals, relative to these, as
root mean squares. A rig has fewer motions than frames; then each round takes a fraction of the
time. With 1e-5, another choice of joints had an error that was 1.5 % larger on one clip of four."""

MIN_ROUGHNESS = 1e-6
"""Weights that are less rough differ by rounding."""

MAX_ACTIVE_SET_STEPS = 50
"""Steps to the minimum on a simplex; few vertices need ten."""

ENTRY_TOL = 1e-9
"""A weight of zero begins to grow if the sum falls by this share of the largest entry of A."""


def group_joints(cage_solve: CageSolve, target: Displacements) -> JointTree:
    """Find in which order the joints of the weights before the fit are merged best."""
    binding = cage_solve.binding
    solver = cage_solve.prepare(binding.weights)
    return JointTree(
        binding.weights * (solver.vertex_weights > 0)[:, None],
        solver.rest,
        target.blocks(),
        np.sqrt(target.shares[target.frames]),
        binding.cage.edges.ends,
    )


def limit_influences(
    alternator: Alternator,
    target: Displacements,
    count: int,
    *,
    turns: bool = False,
    joints: Integers | None = None,
) -> Binding:
    """Fit weights with at most `count` influences to frames.

    They are for joints that only move, or for those that turn, too. These may be fewer than the
    vertices of the cage, each of which becomes one of `joints`, (n,).
    """
    problem, cage_solve = alternator.problem, alternator.cage_solve
    if joints is None and not turns:
        return alternator.fit_influences(target, cage_solve.binding.weights, count)
    moves = FewColumns.of(target, MOVES_TOL)
    if joints is None:
        held = alternator.fit_influences(moves.columns, cage_solve.binding.weights, count)
    else:
        scales = np.sqrt(target.shares[target.frames])
        rest = cage_solve.prepare(cage_solve.binding.weights).rest
        merged = merge_joints(cage_solve.binding, joints)
        held = regroup_vertices(merged, rest, target.blocks, scales)
        problem = replace(problem, rest_weights=held.weights)
        cage_solve = replace(cage_solve, binding=held)
    form = Influences.from_dense(held.weights, count)
    rounds = ROUNDS if joints is None else MERGED_ROUNDS
    weights = fit_turning(problem, cage_solve, target, form, rounds=rounds, moves=moves)
    return replace(held, weights=weights)


def compare_roughness(
    alternator: Alternator, skin: Binding, count: int, joints: Integers | None = None
) -> float | None:
    """Return how rough the weights of a skin are, as a share of those that it began with.

    These are the `count` largest of each vertex before the fit, for cage vertices or for the joints
    that they become. None if those are not rough at all.
    """
    weights, surface = alternator.cage_solve.binding.weights, alternator.problem.surface
    if joints is not None:
        weights = weights @ np.eye(int(joints.max()) + 1)[joints]
    form = Influences.from_dense(weights, count)
    before = surface.measure(form.to_dense(weights.shape[1]))
    return surface.measure(skin.weights) / before if before > MIN_ROUGHNESS else None


def fit_turning(
    problem: WeightProblem,
    cage_solve: CageSolve,
    target: Displacements,
    form: Influences,
    *,
    rounds: int = ROUNDS,
    moves: "FewColumns | None" = None,
) -> Floats:
    """Return weights (m, n) for joints that turn, which begin with those of `form`.

    They are fitted to displacements of frames; `moves` are these, if they are known already.
    """
    n = problem.rest_weights.shape[1]
    problem = replace(problem, regularization=REGULARIZATION)
    roots = np.repeat(np.sqrt(target.shares[target.frames]), 3)
    moves = moves or FewColumns.of(target, MOVES_TOL)
    normals = changes = None
    for _ in range(rounds):
        joints = JointSolver(cage_solve.prepare(form.to_dense(n)))
        if normals is None:
            normals = FewColumns.of(find_normals(joints, target), NORMALS_TOL)
        right = moves.multiply_left(joints.multiply_moves)
        right = (right + normals.multiply_left(joints.multiply_normals)) / roots
        held = joints.start(right) if changes is None else changes
        changes = joints.sweep(right, held, SWEEPS_PER_ROUND)
        system = SkinSystem(joints, moves, normals, changes * roots)
        form = refit_skin(problem, form, system)
    return form.to_dense(n)


@dataclass(frozen=True, slots=True, eq=False)
class FewColumns:
    """Displacements, or changes of normals, D (m, 3k), as D V of fewer columns times Vᵀ.

    Attributes
    ----------
    columns : Displacements
        D V, or D.
    basis : (3k, b) float64, optional
        V; the identity if absent.
    weight : float
        How many frames of the clips those of D stand for.
    """

    columns: Displacements
    basis: Floats | None
    weight: float

    @staticmethod
    def of(target: Displacements, tolerance: float) -> "FewColumns":
        """Return D with as few columns as a tolerance allows, or all where that is hardly less."""
        basis = target.find_basis(tolerance)
        columns = target if basis is None else target.project(basis)
        return FewColumns(columns, basis, target.weight)

    def multiply_left(self, multiply: Callable[[Floats], Floats]) -> Floats:
        """Return a linear image of D's columns, (a, 3k), which `multiply` returns of blocks."""
        found = np.hstack([multiply(block) for block in self.columns.blocks()])
        return found if self.basis is None else found @ self.basis.T

    def reduce(self, rows: Floats) -> Floats:
        """Return rows (a, 3k) in the basis, so that D times their transpose is of few columns."""
        return rows if self.basis is None else rows @ self.basis


def find_normals(joints: JointSolver, target: Displacements) -> Displacements:
    """Return how the normals change in the frames of `target`, scaled as these are."""
    roots = np.repeat(np.sqrt(target.shares), 3)
    parts, done = [], 0
    for part in target.parts:
        scales = roots[done : done + part.shape[1]]
        found = joints.change_normals(part.astype(np.float64) / scales) * scales
        parts.append(found.astype(part.dtype))
        done += part.shape[1]
    return replace(target, parts=tuple(parts))


class SkinSystem:
    """The least squares of each vertex over the weights of joints, summed over frames.

    Parameters
    ----------
    moves, normals : FewColumns
        How vertices and their normals change, of lengths as of `JointSolver.change_normals`.
    changes : (4n, 3k) float64
        Of the joints, scaled as the frames of the target are.

    Attributes
    ----------
    scale : float
        s: how much joints move, summed over frames. It does not fall below rounding, so that
        weights are not fitted to that.
    """

    def __init__(
        self, joints: JointSolver, moves: FewColumns, normals: FewColumns, changes: Floats
    ) -> None:
        lifted = joints.lift(changes)
        diagonal = joints.solver.binding.rest.diagonal
        self._terms = tuple(
            (features, part.columns, part.reduce(lifted).T)
            for features, part in ((joints.points / diagonal, moves), (joints.normals, normals))
        )
        self._points, self._normals = joints.points, joints.normals
        n = len(changes) // 4
        self._products = (lifted @ lifted.T).reshape(n, 4, n, 4)
        shifts = changes.reshape(n, 4, -1)[:, 3]
        rounded = 3 * moves.weight * ROUNDING_TOL**2
        self.scale = max(float(np.square(shifts).sum()) / n, rounded)

    def multiply(self, rows: slice) -> Floats:
        """Return Σ d u_j of some vertices for all joints, (p, n)."""
        found = np.zeros((len(self._points[rows]), len(self._products)))
        for features, columns, lifted in self._terms:
            along = (columns.read_rows(rows) @ lifted).reshape(*found.shape, 4)
            found += np.einsum("pja,pa->pj", along, features[rows])
        return found

    def measure_joints(self, rows: slice) -> Floats:
        """Return Σ |u_j|² of some vertices for all joints, (p, n)."""
        numbers = np.arange(len(self._products))
        own = self._products[numbers, :, numbers].reshape(-1, 16)
        return np.asarray(self._multiply_features(rows).reshape(-1, 16) @ own.T)

    def read_matrices(self, rows: slice, joints: Integers) -> Floats:
        """Return Σ u_j u_k of some vertices for joints (p, K), as (p, K, K)."""
        chosen = self._products[joints[:, :, None], :, joints[:, None]]
        return np.asarray(np.einsum("pklab,pab->pkl", chosen, self._multiply_features(rows)))

    def _multiply_features(self, rows: slice) -> Floats:
        """Return the outer products, (p, 4, 4), of what the joints move of some vertices."""
        points, normals = self._points[rows], self._normals[rows]
        products = points[:, :, None] * points[:, None] + normals[:, :, None] * normals[:, None]
        return np.asarray(products)


def refit_skin(problem: WeightProblem, start: Influences, system: SkinSystem) -> Influences:
    """Return the best weights of as many joints per vertex as `start` has, chosen near these."""
    n, (m, count) = problem.rest_weights.shape[1], start.places.shape
    dense, width = start.to_dense(n), count_columns(m)
    goal = np.empty_like(dense)
    for first in range(0, n, width):
        block = slice(first, first + width)
        goal[:, block] = dense[:, block] - problem.surface.forward @ dense[:, block] / 2
    tried = min(n, count + TRIED_JOINTS)
    size = max(1, MAX_ROW_ENTRIES // max(16 * tried**2, 8 * n))

    def solve_block(first: int) -> Influences:
        rows = slice(first, first + size)
        scale: float | Floats = 1 / system.scale
        if problem.vertex_weights is not None:
            scale = problem.vertex_weights[rows, None] / system.scale
        linear = scale * system.multiply(rows) + problem.regularization * goal[rows]
        alone = scale * system.measure_joints(rows) - 2 * linear
        np.put_along_axis(alone, start.places[rows], -np.inf, axis=1)
        joints = np.sort(np.argpartition(alone, tried - 1, axis=1)[:, :tried], axis=1)
        matrices = np.atleast_2d(scale)[:, :, None] * system.read_matrices(rows, joints)
        matrices[:, np.arange(tried), np.arange(tried)] += problem.regularization
        chosen = np.take_along_axis(linear, joints, axis=1)
        held = np.take_along_axis(dense[rows], joints, axis=1)
        weights = keep_cheapest(matrices, chosen, held, count)
        kept = np.sort(np.argpartition(-weights, count - 1, axis=1)[:, :count], axis=1)
        return Influences(
            np.take_along_axis(joints, kept, axis=1), np.take_along_axis(weights, kept, axis=1)
        )

    with OrderedMap(solve_block, range(0, m, size), problem.jobs, problem.jobs) as solved:
        blocks = list(solved)
    return Influences(
        np.concatenate([block.places for block in blocks]),
        np.concatenate([block.weights for block in blocks]),
    )


def keep_cheapest(matrices: Floats, linear: Floats, start: Floats, count: int) -> Floats:
    """Return minima as of `minimize_on_faces`, with at most `count` weights above zero in a row.

    While there are more, that one is set to zero which costs least if no other one becomes
    negative: w_j² over the entry of j in the inverse of A on the plane of sum one.
    """
    may_grow = np.ones(linear.shape, bool)
    found = minimize_on_faces(matrices, linear, start, may_grow)
    while len(crowded := np.flatnonzero((found > 0).sum(axis=1) > count)):
        weights = found[crowded]
        inverse = np.linalg.inv(mask_matrices(matrices[crowded], weights > 0))
        inverse = np.where((weights > 0)[:, None], inverse, 0)
        sums = inverse.sum(axis=2)
        entries = np.einsum("pkk->pk", inverse) - sums**2 / sums.sum(axis=1, keepdims=True)
        costs = np.where(weights > 0, weights**2 / np.where(weights > 0, entries, 1), np.inf)
        dropped = costs.argmin(axis=1)
        may_grow[crowded, dropped] = False
        weights[np.arange(len(crowded)), dropped] = 0
        weights /= weights.sum(axis=1, keepdims=True)
        found[crowded] = minimize_on_faces(
            matrices[crowded], linear[crowded], weights, may_grow[crowded]
        )
    return found


def minimize_on_faces(matrices: Floats, linear: Floats, start: Floats, may_grow: Mask) -> Floats:
    """Return the minima of ½ wᵀA w − bᵀw over the simplex, for many A and b, from starts on it.

    Parameters
    ----------
    matrices : (p, K, K) float64
        A, symmetric and positive definite.
    linear, start : (p, K) float64
    may_grow : (p, K) bool
        Where a weight that is zero may become more.
    """
    found, is_free, left = start.copy(), start > 0, np.arange(len(start))
    for _ in range(MAX_ACTIVE_SET_STEPS):
        if not len(left):
            break
        now, free = found[left], is_free[left]
        right = np.stack([np.where(free, linear[left], 0), free], axis=2)
        solved = np.linalg.solve(mask_matrices(matrices[left], free), right)
        sums = solved.sum(axis=1)
        level = (1 - sums[:, :1]) / sums[:, 1:]
        best = solved[:, :, 0] + level * solved[:, :, 1]
        is_negative = free & (best < 0)
        lengths = np.ones_like(best)
        np.divide(now, now - best, out=lengths, where=is_negative)
        length = lengths.min(axis=1, keepdims=True)
        stops = is_negative & (lengths == length)
        now = np.where(stops | ~free, 0, now + length * (best - now))
        slopes = np.einsum("pkl,pl->pk", matrices[left], now) - linear[left] - level
        slopes[free | ~may_grow[left]] = np.inf
        least = slopes.argmin(axis=1)
        tolerance = ENTRY_TOL * np.einsum("pkk->pk", matrices[left]).max(axis=1)
        enters = ~stops.any(axis=1) & (slopes.min(axis=1) < -tolerance)
        free &= ~stops
        free[enters, least[enters]] = True
        found[left], is_free[left] = now, free
        left = left[enters | stops.any(axis=1)]
    found = np.maximum(found, 0)
    return np.asarray(found / found.sum(axis=1, keepdims=True))


def mask_matrices(matrices: Floats, is_free: Mask) -> Floats:
    """Return matrices (p, K, K) with the rows and columns of an identity where nothing is free."""
    identity = np.eye(matrices.shape[1])
    return np.where(is_free[:, :, None] & is_free[:, None], matrices, identity)
