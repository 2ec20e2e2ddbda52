"""The joints of a skin that turn: their rotations and places, and the normals that follow.

A skin with weights w moves a vertex x of the rest pose, and turns its normal n, by

    v = Σ_j w_j ((x − p_j) R_j + t_j),      n' = Σ_j w_j n R_j,

with p_j the rest places of the joints, t_j their places in the frame and R_j their rotations. The
frame (v̂, n̂) is followed by

    minimise  (β/m) Σ_i (|v_i − v̂_i|² + ℓ² |n'_i − n̂_i|²)  +  (α/n) |L (t − p)|²
              +  (β ℓ²/n) η Σ_j |(L R)_j|²

over rotations R_j and places t_j. The last two terms decide for joints that few vertices follow:
they move and turn with their neighbours in the cage.

With any matrices M_j in place of the R_j, all is linear. That, with ρ |M_j − R_j|² for the
rotation R_j nearest to M_j, by turns, is the start (as local and global steps of Sorkine and Alexa
2007): its matrix is the same for all frames, and so factored once. But the rotations nearest to the
best matrices are not the best rotations. So the joints then move in turn, each to its best rigid
motion for what the others leave (Kabsch 1976; Le and Deng 2012, section 3.4). With the entries
(E, e; eᵀ, μ) of joint j in the matrix, and (r, s) left of the right-hand side, that is

    R = the rotation nearest to  r − e s/μ + E − e eᵀ/μ,      t − p = (s − eᵀ (R − 1))/μ,

because |y R| = |y|. The sums over the vertices are in the matrix: a sweep over all joints costs the
same for any mesh. Joints that have nothing to do with each other move at once.

All is solved relative to the best rigid motion of the frame, so that a rigid motion turns all
joints alike, and in displacements, so that the rest pose gives identities exactly. Each frame is
solved for itself; `jumps` smooths joints that jump from one to the next.

Of n' only the direction is a normal.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.points import columns_to_frames, frames_to_columns
from cageik_cli.geometry.rotations import nearest_rotations_by_entry
from cageik_cli.geometry.shape import compute_vertex_normals, uniform_laplacian
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.weights.binding import Poses
from cageik_cli.util.arrays import Floats, Integers, Mask

NORMAL_LENGTH = 0.0075
"""A normal off by a radian counts as a vertex off by this share ℓ of the diagonal.

On a dancer, 0.005 has an error that is 2 % smaller, and normals that are 8 % further off.
"""

ROTATION_PULL = 0.03
"""A matrix is pulled to the rotation nearest to it by ρ, relative to one normal per joint."""

ROTATION_SMOOTHNESS = 0.1
"""Rotations are kept smooth over the cage by η, in the same measure as ρ."""

ROTATION_STEPS = 4
"""Matrices and rotations take so many turns, before the rotations themselves are fitted."""

SWEEPS = 8
"""So many times all joints move in turn; 50 sweeps have an error that is 0.5 % smaller."""

MAX_ROW_ENTRIES = 1 << 22
"""Rows that are multiplied at once have at most so many entries."""

MAX_SPARSE_SHARE = 0.2
"""Weights are multiplied as sparse ones if so few are not zero."""

ANGLES_PER_DEGREE = 20
"""Angles of normals are counted in so many steps per degree."""


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
    normals : (k, m, 3) float64, optional
        Those of the frames that joints which turn follow, as of `compute_vertex_normals`.
    jumps : (k, n) bool, optional
        Which joints jump from the frame before.
    """

    rotations: Floats
    meshes: Floats
    turns: Floats | None = None
    normals: Floats | None = None
    jumps: Mask | None = None


@dataclass(frozen=True, slots=True, eq=False)
class JointFrames:
    """The joints of k frames as they are solved.

    Attributes
    ----------
    right, changes : (4n, 3k) float64
        The right-hand side, and the changes of the joints.
    centres, rotations : (k, 3), (k, 3, 3) float64
        The best rigid motion of each frame.
    surface : (k, n, 3, 3) float64
        Rotations nearest to how the surface around each joint is turned, as `turns`.
    normals : (k, m, 3) float64
        Of the aligned frames.
    still, misfit : (k,) float64
        The sum that is minimised, with the joints at rest, and where each frame is solved for
        itself.
    """

    right: Floats
    changes: Floats
    still: Floats
    misfit: Floats
    centres: Floats
    rotations: Floats
    surface: Floats
    normals: Floats

    @property
    def turns(self) -> Floats:
        """R_j of each joint, with the whole, (k, n, 3, 3)."""
        n, count = len(self.changes) // 4, len(self.rotations)
        parts = self.changes.reshape(n, 4, count, 3)
        turns = np.eye(3) + parts[:, :3].transpose(2, 0, 1, 3)
        return np.asarray(turns @ self.rotations[:, None])


class JointSolver:
    """Solves joints that turn for any number of frames, with two factorisations.

    Frames are aligned with the rest pose, as displacements in columns (m, 3k). The changes of the
    joints, (4n, 3k), are R − 1 above t − p of each, in diagonals of the rest pose.

    Parameters
    ----------
    solver : DualLaplacianSolver
        Of a binding whose weights are those of the skin, and whose rest cage has the joints at rest
        as its vertices. It aligns the frames, and its terms keep the places smooth.

    Attributes
    ----------
    points, normals : (m, 4) float64
        What the joints move: (x, 1), in diagonals, and ℓ (n, 0), of the rest pose.
    """

    def __init__(self, solver: DualLaplacianSolver) -> None:
        self.solver, rest = solver, solver.binding.rest
        m, n = solver.binding.weights.shape
        self._weights, self._diagonal = compact_weights(solver.binding.weights), rest.diagonal
        self._joints = solver.rest_cage / self._diagonal
        self.points = np.column_stack([solver.rest / self._diagonal, np.ones(m)])
        self._rest_normals = NORMAL_LENGTH * compute_vertex_normals(rest.polygons, rest.vertices)
        self.normals = np.column_stack([self._rest_normals, np.zeros(m)])
        unit = solver.data_scale * NORMAL_LENGTH**2 * m / n
        matrix = self._make_matrix(solver.binding.cage, ROTATION_SMOOTHNESS * unit)
        self._matrix = matrix
        self._groups = [JointGroup(matrix, joints) for joints in find_separate_joints(matrix)]
        self._pull = np.tile(ROTATION_PULL * unit * np.array([1.0, 1, 1, 0]), n)[:, None]
        factor = np.linalg.cholesky(matrix + np.diag(self._pull[:, 0]))
        self._inverse_factor = np.linalg.inv(factor)
        self._centres, self._spreads = self._measure_followers()

    def solve(self, frames: Floats) -> JointFrames:
        """Solve the joints of frames (k, m, 3), each for itself."""
        columns, centres, rotations = self.solver.align(frames)
        normals, moved = self._compute_normals(columns), self.multiply_moves(columns)
        turned = self._scale_normals(normals)
        right = moved + self.multiply_normals(turned)
        changes = self.sweep(right, self.start(right), SWEEPS)
        shares = self.solver.data_scale * self.solver.vertex_weights
        still = shares @ (np.square(columns / self._diagonal) + np.square(turned))
        still = still.reshape(-1, 3).sum(axis=1)
        return JointFrames(
            right=right,
            changes=changes,
            still=still,
            misfit=still + self.measure_gain(right, changes),
            centres=centres,
            rotations=rotations,
            surface=self._turn_surface(moved).transpose(2, 0, 1, 3) @ rotations[:, None],
            normals=normals,
        )

    def measure_gain(self, right: Floats, changes: Floats) -> Floats:
        """Return by how much changes from rest, (4n, 3k), alter the sum of each frame, (k,)."""
        gain = changes * (self._matrix @ changes - 2 * right)
        return np.asarray(gain.sum(axis=0).reshape(-1, 3).sum(axis=1))

    def pose(self, solved: JointFrames) -> JointPoses:
        """Return where solved joints are, and the mesh that follows them."""
        changes, rotations, shift = solved.changes, solved.rotations, solved.centres[:, None]
        moves = changes.reshape(len(self._joints), 4, len(rotations), 3)[:, 3].swapaxes(0, 1)
        places = self.solver.rest_cage + self._diagonal * moves
        meshes = self.solver.rest + columns_to_frames(self._skin(changes))
        return JointPoses(
            cages=places @ rotations + shift,
            turns=solved.turns,
            rotations=rotations,
            meshes=meshes @ rotations + shift,
            normals=solved.normals @ rotations,
        )

    def change_normals(self, columns: Floats) -> Floats:
        """Return how displacements (m, 3k) change the normals of length ℓ, as (m, 3k)."""
        return self._scale_normals(self._compute_normals(columns))

    def multiply_moves(self, columns: Floats) -> Floats:
        """Return what displacements, (m, b), add to right-hand sides, (4n, b)."""
        right = np.empty((len(self._joints), 4, columns.shape[1]))
        shares = self.solver.data_scale * self.solver.vertex_weights[:, None] / self._diagonal
        for axis in range(4):
            right[:, axis] = self._weights.T @ (shares * self.points[:, axis, None] * columns)
        right[:, :3] -= self._joints[:, :, None] * right[:, 3:]
        return right.reshape(-1, columns.shape[1])

    def multiply_normals(self, normals: Floats) -> Floats:
        """Return what changes of normals, (m, b), add to right-hand sides, (4n, b)."""
        right = np.zeros((len(self._joints), 4, normals.shape[1]))
        shares = self.solver.data_scale * self.solver.vertex_weights[:, None]
        for axis in range(3):
            right[:, axis] = self._weights.T @ (shares * self.normals[:, axis, None] * normals)
        return right.reshape(-1, normals.shape[1])

    def start(self, right: Floats) -> Floats:
        """Return changes that are near to the best ones for right-hand sides, (4n, 3k)."""
        changes = np.zeros_like(right)
        for _ in range(ROTATION_STEPS):
            pulled = right + self._pull * changes
            changes = self._inverse_factor.T @ (self._inverse_factor @ pulled)
            parts = changes.reshape(len(self._joints), 4, -1, 3)
            parts[:, :3] = find_rotation_changes(parts[:, :3] + np.eye(3)[:, None])
        return changes

    def sweep(
        self, right: Floats, changes: Floats, count: int, pulls: Floats | None = None
    ) -> Floats:
        """Move each joint in turn to where it is best for what the others leave, `count` times.

        Rotations are drawn towards matrices (n, 3, k, 3), `pulls`: by these, in the inertia of the
        joint.
        """
        changes = changes.copy()
        for _ in range(count):
            for group in self._groups:
                group.move(right, changes, pulls)
        return changes

    def lift(self, changes: Floats) -> Floats:
        """Return how changes of the joints, (4n, 3k), move points (x, 1) at rest, (4n, 3k)."""
        lifted = changes.reshape(len(self._joints), 4, -1).copy()
        lifted[:, 3] -= np.einsum("na,nab->nb", self._joints, lifted[:, :3])
        return lifted.reshape(changes.shape)

    def _skin(self, changes: Floats) -> Floats:
        """Return the displacements, (m, 3k), of the mesh that follows the joints."""
        lifted = self._diagonal * self.lift(changes).reshape(len(self._joints), 4, -1)
        skinned = np.zeros((len(self.points), changes.shape[1]))
        for axis in range(4):
            along = self._weights @ np.ascontiguousarray(lifted[:, axis])
            skinned += self.points[:, axis, None] * along
        return skinned

    def _measure_followers(self) -> tuple[Floats, Floats]:
        """Return the centre of what follows each joint, (n, 3), and its Σ (x − x̄)ᵀ(x − x̄).

        Centres are relative to the joints.
        """
        n, shares = len(self._joints), self.solver.data_scale * self.solver.vertex_weights
        products = self.points[:, :, None] * self.points[:, None, :]
        moments = self._weights.T @ (shares[:, None] * products.reshape(-1, 16))
        moments = np.asarray(moments).reshape(n, 4, 4)
        mass = np.where(moments[:, 3, 3] > 0, moments[:, 3, 3], 1)
        centres = moments[:, :3, 3] / mass[:, None]
        spreads = moments[:, :3, :3] - centres[:, :, None] * moments[:, 3, None, :3]
        return centres - self._joints, spreads

    def _turn_surface(self, moved: Floats) -> Floats:
        """Return the rotations, (n, 3, k, 3), nearest to how displacements turn what follows.

        These are as `multiply_moves` has them, (4n, 3k).
        """
        parts = moved.reshape(len(self._joints), 4, -1, 3)
        turned = parts[:, :3] - self._centres[:, :, None, None] * parts[:, 3:]
        changes = find_rotation_changes(turned + self._spreads[:, :, None])
        return np.asarray(changes + np.eye(3)[:, None])

    def _compute_normals(self, columns: Floats) -> Floats:
        """Return the normals, (k, m, 3), of frames with displacements (m, 3k)."""
        polygons = self.solver.binding.rest.polygons
        frames = self.solver.rest + columns_to_frames(columns)
        return np.stack([compute_vertex_normals(polygons, frame) for frame in frames])

    def _scale_normals(self, normals: Floats) -> Floats:
        """Return how normals, (k, m, 3), differ from those at rest, with length ℓ, (m, 3k)."""
        return frames_to_columns(NORMAL_LENGTH * normals - self._rest_normals)

    def _make_matrix(self, cage: TriMesh, smoothness: float) -> Floats:
        """Return the matrix of the rotations and the places, joint by joint, (4n, 4n)."""
        n = len(self._joints)
        matrix = np.zeros((n, 4, n, 4))
        shares = self.solver.data_scale * self.solver.vertex_weights
        for features in (self.points, self.normals):
            for a, b in zip(*np.triu_indices(4), strict=True):
                scales = shares * features[:, a] * features[:, b]
                matrix[:, a, :, b] += multiply_weights(self._weights, scales)
                matrix[:, b, :, a] = matrix[:, a, :, b]
        matrix[:, :3] -= self._joints[:, :, None, None] * matrix[:, 3:]
        matrix[:, :, :, :3] -= matrix[:, :, :, 3:] * self._joints
        laplacian = uniform_laplacian(cage)
        for axis in range(3):
            matrix[:, axis, :, axis] += smoothness * laplacian.T @ laplacian
        matrix[:, 3, :, 3] += self.solver.smoothness
        return matrix.reshape(4 * n, 4 * n)


class JointGroup:
    """Joints of which none has to do with another: of the matrix, (4n, 4n), of all joints."""

    def __init__(self, matrix: Floats, joints: Integers) -> None:
        self._count, self._joints = len(joints), joints
        self._rows = (4 * joints[:, None] + np.arange(4)).ravel()
        self._matrix = matrix[self._rows]
        local = self._rows.reshape(-1, 4)
        self._own = matrix[local[:, :, None], local[:, None, :]]
        self._arms = self._own[:, :3, 3] / self._own[:, 3, 3, None]
        spread = self._own[:, :3, 3, None] * self._arms[:, None]
        self._inertia = (self._own[:, :3, :3] - spread)[:, :, None]
        self._sizes = np.einsum("naka->n", self._inertia)[:, None, None, None]

    def move(self, right: Floats, changes: Floats, pulls: Floats | None = None) -> None:
        """Move the joints to where they are best for what the others leave; overwrites changes."""
        held = changes[self._rows].reshape(self._count, 4, -1)
        left = (right[self._rows] - self._matrix @ changes).reshape(held.shape)
        left += self._own @ held
        turned = left[:, :3] - self._arms[:, :, None] * left[:, 3:]
        turned = turned.reshape(self._count, 3, -1, 3) + self._inertia
        if pulls is not None:
            turned += self._sizes * pulls[self._joints]
        held[:, :3] = find_rotation_changes(turned).reshape(self._count, 3, -1)
        along = np.einsum("na,nab->nb", self._arms, held[:, :3])
        held[:, 3] = left[:, 3] / self._own[:, 3, 3, None] - along
        changes[self._rows] = held.reshape(len(self._rows), -1)


def find_separate_joints(matrix: Floats) -> list[Integers]:
    """Group joints, of a matrix (4n, 4n), so that none of a group has to do with another of it."""
    n = len(matrix) // 4
    is_linked = np.asarray(matrix.reshape(n, 4, n, 4).any(axis=(1, 3)))
    groups: list[list[int]] = []
    for joint in range(n):
        fitting = [group for group in groups if not is_linked[joint, group].any()]
        if fitting:
            fitting[0].append(joint)
        else:
            groups.append([joint])
    return [np.array(group) for group in groups]


def find_rotation_changes(matrices: Floats) -> Floats:
    """Return R − 1 for the rotations R nearest to matrices, of n joints in k frames.

    All are (n, 3, k, 3): rows of a matrix are on the second axis, columns on the last.
    """
    n, _, count, _ = matrices.shape
    turns = nearest_rotations_by_entry(matrices.transpose(1, 3, 0, 2).reshape(9, -1))
    changes = turns.reshape(3, 3, n, count) - np.eye(3)[:, :, None, None]
    return changes.transpose(2, 0, 3, 1)


def compact_weights(weights: Floats) -> Any:
    """Return weights (m, n) for products, as a sparse array if few are not zero."""
    from scipy import sparse

    is_sparse = np.count_nonzero(weights) <= MAX_SPARSE_SHARE * weights.size
    return sparse.csr_array(weights) if is_sparse else weights


def multiply_weights(weights: Any, scales: Floats) -> Floats:
    """Return Σ_i scales_i w_iᵀ w_i, (n, n), of the rows of weights from `compact_weights`."""
    from scipy import sparse

    if sparse.issparse(weights):
        return np.asarray((weights.T @ (sparse.diags_array(scales) @ weights)).toarray())
    n = weights.shape[1]
    found, size = np.zeros((n, n)), max(1, MAX_ROW_ENTRIES // n)
    for start in range(0, len(weights), size):
        rows = slice(start, start + size)
        found += weights[rows].T @ (scales[rows, None] * weights[rows])
    return found


def turn_normals(normals: Floats, weights: Any, turns: Floats) -> Floats:
    """Return normals (m, 3) as skins of weights (m, n) turn them by (k, n, 3, 3); of length 1.

    They are (k, m, 3). The weights may be sparse.
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
        self._rest, self._weights = rest, compact_weights(weights)
        self._normals = compute_vertex_normals(rest.polygons, rest.vertices)
        self._counts = np.zeros(180 * ANGLES_PER_DEGREE + 1, np.int64)
        self._squares = 0.0

    def add(self, turns: Floats, meshes: Floats, normals: Floats | None = None) -> None:
        """Add the angles of frames, (k, m, 3), whose joints turn by (k, n, 3, 3).

        `normals` are theirs, (k, m, 3), where they are known already.
        """
        if normals is None:
            normals = np.stack([compute_vertex_normals(self._rest.polygons, one) for one in meshes])
        found = turn_normals(self._normals, self._weights, turns)
        for expected, shaded in zip(normals, found, strict=True):
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
