"""Weights of few influences for joints that turn: weights and joints by turns.

For given joints each vertex is Σ_j w_j u_j, with u_j where joint j alone would take it. So the
weights of each vertex are least squares on the simplex again, as in `influences.py`, also with the
normals. With x̂ = (x, 1), and T_j (4, 3k) the moves of joint j in all frames, u_j − x is x̂ T_j, and
the products of two of them are

    (u_j − x)·(u_l − x) = x̂ᵀ S_jl x̂,      S_jl = T_j T_lᵀ,

which no vertex needs the frames for. The upper three rows of T_j are R_j − 1, so the same S gives
the products of the turned normals.
"""

from dataclasses import replace

import numpy as np

from cageik_cli.fit.alternate import Alternator, CageSolve, Influences, solve_rows
from cageik_cli.fit.problem import ROUNDING_TOL, Displacements, WeightProblem
from cageik_cli.method.weights.binding import Binding
from cageik_cli.rigs.joints import MAX_ROW_ENTRIES, NORMAL_LENGTH, JointSolver
from cageik_cli.rigs.merging import JointTree, merge_joints
from cageik_cli.util.arrays import Floats, Integers

TURNING_REGULARIZATION = 0.01
"""Weights have a λ this small: their frames have no noise that smooth weights would keep out."""

TURNING_ROUNDS = 5
"""Joints and weights take so many rounds; after three, the error is 3 to 15 % larger."""


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
    """Fit weights with at most `count` influences to frames that the weights before give.

    They are for joints that only move, or for those that turn, too. These may be fewer than the
    vertices of the cage, each of which becomes one of `joints`, (n,).
    """
    problem, cage_solve = alternator.problem, alternator.cage_solve
    if joints is not None:
        merged = merge_joints(cage_solve.binding, joints)
        problem = replace(problem, rest_weights=merged.weights)
        cage_solve, weights = replace(cage_solve, binding=merged), merged.weights
        for most in (2 * count, count):  # else the strongest before the fit would decide
            form = Influences.from_dense(weights, most)
            weights = fit_turning(problem, cage_solve, target, form)
        return replace(merged, weights=weights)
    limited = alternator.fit_influences(target, cage_solve.binding.weights, count)
    if not turns:
        return limited
    form = Influences.from_dense(limited.weights, count)
    return replace(limited, weights=fit_turning(problem, cage_solve, target, form))


def fit_turning(
    problem: WeightProblem, cage_solve: CageSolve, target: Displacements, form: Influences
) -> Floats:
    """Return weights (m, n) for joints that turn, which begin with those of `form`.

    They are fitted to displacements of frames in `TURNING_ROUNDS` rounds.
    """
    n = problem.rest_weights.shape[1]
    problem = replace(problem, regularization=TURNING_REGULARIZATION)
    shares = np.sqrt(target.shares[target.frames])
    for _ in range(TURNING_ROUNDS):
        joints = JointSolver(cage_solve.prepare(form.to_dense(n)))
        system, done = TurningSystem(joints, form.places), 0
        for block in target.blocks():
            scales = shares[done : done + block.shape[1] // 3]
            system.add(block, np.repeat(scales, 3))
            done += len(scales)
        form = solve_rows(problem, form, system.read_rows)
    return form.to_dense(n)


class TurningSystem:
    """The least squares of each vertex over the joints at its places, summed over frames."""

    def __init__(self, joints: JointSolver, places: Integers) -> None:
        self._joints, self._places = joints, places
        solver, m = joints.solver, len(places)
        n = len(solver.rest_cage)
        self._points = np.column_stack([solver.rest, np.ones(m)])
        length = NORMAL_LENGTH * solver.binding.rest.diagonal
        self._normals = length * np.column_stack([joints.normals, np.zeros(m)])
        self._length = length
        self._products = np.zeros((4 * n, 4 * n))
        self._right = np.zeros(places.shape)
        self._moved, self._rounded = 0.0, 0.0
        self._rounding = ROUNDING_TOL * solver.binding.rest.diagonal

    def add(self, scaled: Floats, scales: Floats) -> None:
        """Add displacements (m, 3k) of frames, which are scaled by `scales`, (3k,)."""
        columns = scaled / scales
        normals = self._joints.change_normals(columns)
        turns, moves = self._joints.solve_columns(columns, normals)
        lifted = self._joints.lift(turns, moves).reshape(-1, len(scales)) * scales
        self._products += lifted @ lifted.T
        self._moved += float(np.square(moves * scales).sum()) / len(moves)
        self._rounded += float(np.square(self._rounding * scales).sum())
        normals *= self._length * scales
        size = max(1, MAX_ROW_ENTRIES // len(lifted))
        for start in range(0, len(scaled), size):
            rows = slice(start, start + size)
            for features, target in ((self._points, scaled), (self._normals, normals)):
                found = (target[rows] @ lifted.T).reshape(-1, len(moves), 4)
                chosen = np.take_along_axis(found, self._places[rows, :, None], axis=1)
                self._right[rows] += np.einsum("pka,pa->pk", chosen, features[rows])

    def read_rows(self, rows: slice) -> tuple[Floats, Floats]:
        """Return matrices (p, K, K) and right-hand sides (p, K) of some vertices."""
        places, points, normals = self._places[rows], self._points[rows], self._normals[rows]
        n = len(self._products) // 4
        blocks = self._products.reshape(n, 4, n, 4)
        features = points[:, :, None] * points[:, None] + normals[:, :, None] * normals[:, None]
        chosen = blocks[places[:, :, None], :, places[:, None]]
        matrices = np.einsum("pklab,pab->pkl", chosen, features)
        scale = max(self._moved, self._rounded)  # weights are not fitted to rounding
        return matrices / scale, self._right[rows] / scale
