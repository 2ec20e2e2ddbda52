"""The joints of a skin that turn: their rotations and places, and the normals that follow.

A skin with weights w moves a vertex x of the rest pose, and turns its normal n, by

    v = Σ_j w_j ((x − p_j) R_j + t_j),      n' = Σ_j w_j n R_j,

with p_j the rest places of the joints, t_j their places in the frame and R_j their rotations.
With any matrices M_j in place of the R_j, both are linear. The frame (v̂, n̂) is followed by

    minimise  (β/m) Σ_i (|v_i − v̂_i|² + ℓ² |n'_i − n̂_i|²)  +  (α/n) |L (t − p)|²
              +  (β ℓ²/n) Σ_j (ρ |M_j − R_j|² + η |(L M)_j|²)

and by R_j = the rotation nearest to M_j, by turns (as local and global steps of Sorkine and Alexa
2007). Its matrix is the same for all frames, and so factored once. The last two terms decide for
joints that few vertices follow: they turn with their neighbours in the cage, or with the whole.
Then the places are solved again for the rotations that were found.

All is solved relative to the best rigid motion of the frame, so that a rigid motion turns all
joints alike, and in displacements, so that the rest pose gives identities exactly.

Of n' only the direction is a normal.
"""

from dataclasses import dataclass, replace

import numpy as np

from cageik_cli.fit.alternate import Alternator, CageSolve, Influences, solve_rows
from cageik_cli.fit.problem import ROUNDING_TOL, Displacements, WeightProblem
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.points import columns_to_frames, frames_to_columns
from cageik_cli.geometry.rotations import nearest_rotations_by_entry
from cageik_cli.geometry.shape import compute_vertex_normals, uniform_laplacian
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.weights.binding import Binding, Poses
from cageik_cli.rigs.merging import JointTree, merge_joints
from cageik_cli.util.arrays import Floats, Integers

NORMAL_LENGTH = 0.0075
"""A normal off by a radian counts as a vertex off by this share ℓ of the diagonal.

On a dancer, 0.005 has an error that is 2 % smaller, and normals that are 8 % further off.
"""

ROTATION_PULL = 0.03
"""A matrix is pulled to the rotation nearest to it by ρ, relative to one normal per joint."""

ROTATION_SMOOTHNESS = 1e-3
"""Rotations are kept smooth over the cage by η, in the same measure as ρ."""

ROTATION_STEPS = 4
"""Matrices and rotations take so many turns; more change error and normals by less than 1 %."""

MAX_ROW_ENTRIES = 1 << 22
"""Rows that are multiplied at once have at most so many entries."""

ANGLES_PER_DEGREE = 20
"""Angles of normals are counted in so many steps per degree."""

TURNING_REGULARIZATION = 0.01
"""Weights have a λ this small: their frames have no noise that smooth weights would keep out."""

TURNING_ROUNDS = 5
"""Joints and weights take so many rounds; after three, the error is 3 to 15 % larger."""


@dataclass(frozen=True, slots=True, eq=False)
class JointPoses(Poses):
    """The joints of k frames, at the vertices of their cages, and the mesh that follows them.

    Attributes
    ----------
    rotations : (k, 3, 3) float64
        R of the whole.
    meshes : (k, m, 3) float64
    turns : (k, n, 3, 3) float64, optional
        R_j of each joint, in the same sense; joints that only translate have none.
    """

    rotations: Floats
    meshes: Floats
    turns: Floats | None = None


class JointSolver:
    """Solves joints that turn for any number of frames, with two factorisations.

    Parameters
    ----------
    solver : DualLaplacianSolver
        Of a binding whose weights are those of the skin, and whose rest cage has the joints at rest
        as its vertices. It solves the places, and aligns the frames.
    """

    def __init__(self, solver: DualLaplacianSolver) -> None:
        self.solver, binding = solver, solver.binding
        self._weights, self._diagonal = binding.weights, binding.rest.diagonal
        self._points = solver.rest / self._diagonal
        self._joints = solver.rest_cage / self._diagonal
        self.normals = compute_vertex_normals(binding.rest.polygons, binding.rest.vertices)
        vertices_per_joint = len(self._points) / len(self._joints)
        self._pull = solver.data_scale * NORMAL_LENGTH**2 * vertices_per_joint * ROTATION_PULL
        factor = np.linalg.cholesky(self._make_matrix(binding.cage))
        self._inverse_factor = np.linalg.inv(factor)

    def solve(self, frames: Floats) -> JointPoses:
        """Return the joints of frames (k, m, 3)."""
        columns, centres, rotations = self.solver.align(frames)
        turns, moves = self.solve_columns(columns, self.change_normals(columns))
        meshes = self.solver.rest + columns_to_frames(self._skin(turns, moves))
        places = self.solver.rest_cage + columns_to_frames(moves)
        whole, shift = rotations[:, None], centres[:, None]
        return JointPoses(
            cages=places @ rotations + shift,
            turns=turns @ whole,
            rotations=rotations,
            meshes=meshes @ rotations + shift,
        )

    def solve_columns(self, columns: Floats, normals: Floats) -> tuple[Floats, Floats]:
        """Return the joints for displacements of frames aligned with the rest pose.

        They are the rotations (k, n, 3, 3) and the displacements of the joints (n, 3k).

        Parameters
        ----------
        columns, normals : (m, 3k) float64
            How vertices and their normals change from the rest pose.
        """
        turns = self._solve_rotations(columns, normals)
        still = np.zeros((len(self._joints), columns.shape[1]))
        return turns, self.solver.solve_displacements(columns - self._skin(turns, still))

    def change_normals(self, columns: Floats) -> Floats:
        """Return how the normals of the rest pose change with displacements (m, 3k), as (m, 3k)."""
        frames = self.solver.rest + columns_to_frames(columns)
        found = [
            compute_vertex_normals(self.solver.binding.rest.polygons, frame) for frame in frames
        ]
        return frames_to_columns(np.stack(found) - self.normals)

    def _solve_rotations(self, columns: Floats, normals: Floats) -> Floats:
        """Return the rotations of the joints, (k, n, 3, 3)."""
        n, count = len(self._joints), columns.shape[1] // 3
        data = self._multiply(columns / self._diagonal, normals)
        changes = np.zeros((3 * n, 3 * count))  # M - 1, row by row
        for _ in range(ROTATION_STEPS):
            right = data.copy()
            right[: 3 * n] += self._pull * changes
            found = (self._inverse_factor.T @ (self._inverse_factor @ right))[: 3 * n]
            matrices = found.reshape(n, 3, count, 3) + np.eye(3)[:, None]
            entries = matrices.transpose(1, 3, 2, 0).reshape(9, -1)
            turns = nearest_rotations_by_entry(entries).reshape(3, 3, count, n)
            changes = (turns.transpose(3, 0, 2, 1) - np.eye(3)[:, None]).reshape(3 * n, -1)
        return np.ascontiguousarray(turns.transpose(2, 3, 0, 1))

    def lift(self, turns: Floats, moves: Floats) -> Floats:
        """Return how joints move the points (x, 1) of the aligned rest pose, (n, 4, 3k).

        They turn by `turns`, (k, n, 3, 3), and move by `moves`, (n, 3k).
        """
        n = len(moves)
        changes = (turns - np.eye(3)).transpose(1, 2, 0, 3)
        shifts = moves - np.einsum("na,nakb->nkb", self.solver.rest_cage, changes).reshape(n, -1)
        return np.concatenate([changes.reshape(n, 3, -1), shifts[:, None]], axis=1)

    def _skin(self, turns: Floats, moves: Floats) -> Floats:
        """Return the displacements, (m, 3k), of the mesh that follows the joints."""
        lifted = self.lift(turns, moves)
        skinned = self._weights @ lifted[:, 3]
        for axis in range(3):
            along = self._weights @ np.ascontiguousarray(lifted[:, axis])
            skinned += self.solver.rest[:, axis, None] * along
        return np.asarray(skinned)

    def _multiply(self, columns: Floats, normals: Floats) -> Floats:
        """Return the right-hand sides, (4n, 3k), of displacements in diagonals and of normals."""
        scaled = self.solver.vertex_weights[:, None] * columns
        moved = self._weights.T @ scaled
        turned = np.empty((len(self._joints), 3, columns.shape[1]))
        for axis in range(3):
            along = self._weights.T @ (self._points[:, axis, None] * scaled)
            along -= self._joints[:, axis, None] * moved
            weighted = (self.solver.vertex_weights * self.normals[:, axis])[:, None] * normals
            turned[:, axis] = along + NORMAL_LENGTH**2 * (self._weights.T @ weighted)
        rows = np.vstack([turned.reshape(-1, columns.shape[1]), moved])
        return np.asarray(self.solver.data_scale * rows)

    def _make_matrix(self, cage: TriMesh) -> Floats:
        """Return the matrix of the matrices and the places, (4n, 4n)."""
        m, n = self._weights.shape
        matrix = np.zeros((4 * n, 4 * n))
        roots = np.sqrt(self.solver.data_scale * self.solver.vertex_weights)
        size = max(1, MAX_ROW_ENTRIES // (7 * n))
        for start in range(0, m, size):
            rows = slice(start, start + size)
            weights = roots[rows, None] * self._weights[rows]
            arms = self._points[rows, None] - self._joints
            turned = (weights[:, :, None] * arms).reshape(-1, 3 * n)
            places = np.hstack([turned, weights])
            matrix += places.T @ places
            normals = NORMAL_LENGTH * self.normals[rows, None]
            shaded = (weights[:, :, None] * normals).reshape(-1, 3 * n)
            matrix[: 3 * n, : 3 * n] += shaded.T @ shaded
        laplacian = uniform_laplacian(cage)
        smoothness = ROTATION_SMOOTHNESS / ROTATION_PULL * laplacian.T @ laplacian
        pull = self._pull * (np.eye(n) + smoothness)
        matrix[: 3 * n, : 3 * n] += np.kron(pull, np.eye(3))
        matrix[3 * n :, 3 * n :] += self.solver.smoothness
        return matrix


def turn_normals(normals: Floats, weights: Floats, turns: Floats) -> Floats:
    """Return normals (m, 3) as skins of weights (m, n) turn them by (k, n, 3, 3); of length 1.

    They are (k, m, 3).
    """
    count, n = turns.shape[:2]
    found = np.zeros((len(normals), 3 * count))
    for axis in range(3):
        along = turns[:, :, axis].transpose(1, 0, 2).reshape(n, 3 * count)
        found += normals[:, axis, None] * (weights @ along)
    frames = columns_to_frames(found)
    lengths = np.linalg.norm(frames, axis=2, keepdims=True)
    return np.asarray(np.divide(frames, lengths, out=np.zeros_like(frames), where=lengths > 0))


class NormalAngles:
    """Counts angles between the normals of a skin, (m, n) weights, and those of meshes.

    A vertex whose faces cancel has no normal, and is left out.
    """

    def __init__(self, rest: TriMesh, weights: Floats) -> None:
        self._rest, self._weights = rest, weights
        self._normals = compute_vertex_normals(rest.polygons, rest.vertices)
        self._counts = np.zeros(180 * ANGLES_PER_DEGREE + 1, np.int64)
        self._squares = 0.0

    def add(self, turns: Floats, meshes: Floats) -> None:
        """Add the angles of frames, (k, m, 3), whose joints turn by (k, n, 3, 3)."""
        found = turn_normals(self._normals, self._weights, turns)
        for mesh, shaded in zip(meshes, found, strict=True):
            expected = compute_vertex_normals(self._rest.polygons, mesh)
            is_known = self._normals.any(axis=1) & expected.any(axis=1)
            cosines = np.einsum("mx,mx->m", shaded, expected)[is_known]
            angles = np.degrees(np.arccos(cosines.clip(-1, 1)))
            self._squares += float(np.square(angles).sum())
            steps = (angles * ANGLES_PER_DEGREE).astype(np.int64)
            self._counts += np.bincount(steps, minlength=len(self._counts))

    def summarize(self) -> tuple[float, float] | None:
        """Return the root mean square and the 99th percentile, degrees; None of no angles."""
        done = np.cumsum(self._counts)
        if not done[-1]:
            return None
        step = np.searchsorted(done, 0.99 * done[-1])
        return float(np.sqrt(self._squares / done[-1])), float(step / ANGLES_PER_DEGREE)


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
