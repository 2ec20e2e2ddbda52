"""Fill parts of frames without data from the frames around them in time, by one solve.

For F frames with cages c_t, normal matrices A_t = A − E_t (`captured.robust`) and right sides b_t,

    minimise  Σ_t (c_tᵀ A_t c_t − 2 b_tᵀ c_t)  +  γ Σ_t |c_{t−1} − 2 c_t + c_{t+1}|²,

in the frame of the world. The rotation of a frame is only in its Laplacian term, which b_t holds. A
frame without data has no term of its own. Missing vertices are then put where that has them. Whole
frames without data are filled by `captured.smooth`.

Where all A_t are A = U diag(w) Uᵀ, the modes k of A are independent: (w_k I + γ D₂ᵀ D₂) y_k =
Uᵀ b is a pentadiagonal system over time. Where vertices are missing, this solve is the
preconditioner of conjugate gradients. What is occluded for long stays where each frame's own solve
has it: acceleration alone would let it fly.

Vertices that are occluded are put where the surface around them has them, as rigidly as possible.
With the rest pose p, the positions x of the vertices that are seen, and a rotation R_i per vertex,

    minimise  Σ_ij |x_i − x_j − R_i (p_i − p_j)|²  over the occluded x and all R,

in turn (Sorkine and Alexa 2007, with the weight 1 per edge). A cage that is solved without a piece
follows the rest so closely that there it may be anywhere; a surface bends, and does not stretch.

What a cage cannot follow around a piece goes on into it. Residuals r of what is seen are continued
so that Σ_i |Σ_j (r_i − r_j)|² / d_i is least, with the d_i neighbours j of i.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.rotations import nearest_rotations_by_entry
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.util.arrays import Floats, Mask

MAX_CONJUGATE_STEPS = 200
"""Steps of conjugate gradients, at most."""

CONJUGATE_TOL = 1e-4
"""Conjugate gradients end at this share of the error of their start, in the norm of the system."""

BRIDGE_LENGTH = 0.37
"""Length in frames: a motion of the whole mesh with a period of 2π times it would be halved."""

RIGID_ROUNDS = 20
"""Rounds of rotations and positions: with 60, the error is up to a tenth less."""

HOLD_WEIGHT = 1e-9
"""Weight by which vertices stay where they begin: a part of which nothing is seen has no other."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameTerms:
    """What the frames of a window contribute.

    Attributes
    ----------
    cages : (F, n, 3) float64
        Solved frame by frame, in the frame of the world; anything where there are no data.
    is_known : (F,) bool
        Whether a frame has data.
    lost : dict
        By frame, E_t, (n, n), of frames in which vertices weigh less, or are missing, if in no more
        in a row than motion tells of.
    """

    cages: Floats
    is_known: Mask
    lost: dict[int, Floats]


class TimeFiller:
    """Solver over time of the cages of one binding, which fills parts without data.

    The tolerance is as `CONJUGATE_TOL`.
    """

    def __init__(self, solver: DualLaplacianSolver, *, tolerance: float = CONJUGATE_TOL) -> None:
        from scipy.linalg import eigh

        self._tolerance = tolerance
        self._normal = solver.normal
        self._weights, self._modes = eigh(solver.normal)
        self._scale = solver.data_scale * len(solver.rest) / len(self._weights)

    def convert_length(self, frames: float) -> float:
        """Return γ for a length in frames."""
        return float(self._scale * frames**4)

    def fill(self, terms: FrameTerms) -> Floats:
        """Return cages, (F, n, 3), whose missing parts follow those around them in time.

        Frames that are whole, and those without data, are as they were.
        """
        known, cages = terms.is_known, terms.cages
        if len(known) < 3 or known.sum() < 2 or not terms.lost:
            return cages
        right = known[:, None, None] * (self._normal @ cages)
        for t, matrix in terms.lost.items():
            right[t] -= matrix @ cages[t]
        found, filled = self._solve_conjugate(right, terms), cages.copy()
        for t, matrix in terms.lost.items():
            mended = self._modes.T @ (right[t] + matrix @ found[t])
            filled[t] = self._modes @ (mended / self._weights[:, None])
        return filled

    def _solve_conjugate(self, right: Floats, terms: FrameTerms) -> Floats:
        """Solve with the matrix A − E_t of each frame."""
        gamma = self.convert_length(BRIDGE_LENGTH)
        # With the same matrix A in all known frames.
        modes = _ModeSolver(self._weights, self._modes, terms.is_known, gamma)

        def multiply(cages: Floats) -> Floats:
            image = terms.is_known[:, None, None] * (self._normal @ cages)
            for t, matrix in terms.lost.items():
                image[t] -= matrix @ cages[t]
            bends = gamma * np.diff(cages, 2, axis=0)
            image[:-2] += bends
            image[1:-1] -= 2 * bends
            image[2:] += bends
            return np.asarray(image)

        found = modes.solve(right)
        left = right - multiply(found)
        step = modes.solve(left)
        ways, size = step.copy(), (left * step).sum(axis=(0, 1))
        end = self._tolerance**2 * size
        for _ in range(MAX_CONJUGATE_STEPS):
            if (size <= end).all():
                break
            image = multiply(ways)
            along = np.divide(size, (ways * image).sum(axis=(0, 1)), out=size * 0, where=size > 0)
            found += along * ways
            left -= along * image
            step = modes.solve(left)
            before, size = size, (left * step).sum(axis=(0, 1))
            ways = step + np.divide(size, before, out=size * 0, where=before > 0) * ways
        return found


class _ModeSolver:
    """Factors of (w_k o_t I + γ D₂ᵀ D₂) for all modes k, with o_t = 0 in unknown frames."""

    def __init__(self, weights: Floats, modes: Floats, is_known: Mask, gamma: float) -> None:
        from scipy.linalg import cholesky_banded

        self._modes = modes
        bands = make_bend_bands(np.full(len(is_known) - 2, gamma))
        self._factors = []
        for weight in weights:
            own = bands.copy()
            own[2] += weight * is_known
            self._factors.append(cholesky_banded(own, check_finite=False))

    def solve(self, right: Floats) -> Floats:
        """Return the solution (F, n, 3) of right sides (F, n, 3)."""
        from scipy.linalg import cho_solve_banded

        columns = np.ascontiguousarray((self._modes.T @ right).transpose(1, 0, 2))
        for k, factor in enumerate(self._factors):
            pair = (factor, False)
            columns[k] = cho_solve_banded(pair, columns[k], check_finite=False)
        return np.asarray(self._modes @ columns.transpose(1, 0, 2))


def make_bend_bands(gammas: Floats) -> Floats:
    """Return D₂ᵀ diag(γ) D₂ of second differences of F frames in upper bands, (3, F)."""
    bands = np.zeros((3, len(gammas) + 2))
    bands[2, :-2] += gammas
    bands[2, 1:-1] += 4 * gammas
    bands[2, 2:] += gammas
    bands[1, 1:-1] -= 2 * gammas
    bands[1, 2:] -= 2 * gammas
    bands[0, 2:] = gammas
    return bands


class RigidFiller:
    """Filler of frames of a mesh; the factors of the last occluded vertices are kept."""

    def __init__(self, mesh: TriMesh) -> None:
        from scipy import sparse

        ends = mesh.edges.ends
        both = np.concatenate([ends, ends[:, ::-1]])
        self._pairs = both[np.argsort(both[:, 0], kind="stable")]
        self._rest, self._is_occluded = mesh.vertices, np.zeros(len(mesh.vertices), bool)
        self._factor: Any = None
        # The matrix of Σ_i |Σ_j (r_i − r_j)|² / d_i.
        first, second = both.T
        shape = (len(mesh.vertices),) * 2
        joined = sparse.coo_array((np.ones(len(first)), (first, second)), shape=shape)
        degrees = np.bincount(first, minlength=len(mesh.vertices)).astype(float)
        laplacian = sparse.diags_array(degrees) - joined
        means = sparse.diags_array(1 / np.maximum(degrees, 1))
        self._bending = (laplacian @ means @ laplacian).tocsr()

    def extend(self, values: Floats, is_occluded: Mask) -> Floats:
        """Return values (m, 3) whose occluded ones, (m,), continue the others; they may be any."""
        if not (is_occluded == self._is_occluded).all():
            self._prepare(is_occluded)
        extended = values.copy()
        if self._factor is not None:
            extended[is_occluded] = self._bend_factor.solve(-self._across @ values[~is_occluded])
        return extended

    def fill(self, positions: Floats, is_occluded: Mask) -> Floats:
        """Return positions (m, 3), the first guess, whose occluded ones, (m,), are moved."""
        if not (is_occluded == self._is_occluded).all():
            self._prepare(is_occluded)
        filled = positions.copy()
        if self._factor is None:
            return filled
        joined, second = self._joined, self._edges[:, 1]
        here, there = self._ring_edges.T
        for _ in range(RIGID_ROUNDS):
            # The rotation of the rest pose to the positions around each vertex of the ring.
            sides = filled[here] - filled[there]
            products = (sides[:, :, None] * self._ring_sides[:, None, :]).reshape(-1, 9)
            sums = np.add.reduceat(products, self._ring_starts)
            entries = nearest_rotations_by_entry(np.ascontiguousarray(sums.T))
            rotations = entries.T.reshape(-1, 3, 3)
            means = (rotations[self._first_ring] + rotations[self._second_ring]) / 2
            pulls = np.einsum("eab,eb->ea", means, self._sides)
            # What is seen is known: it goes to the other side.
            pulls += np.where(is_occluded[second, None], 0.0, filled[second])
            right = HOLD_WEIGHT * filled[joined]
            right += np.add.reduceat(pulls, self._starts)
            filled[joined] = self._factor.solve(right)
        return filled

    def _prepare(self, is_occluded: Mask) -> None:
        """List the edges at occluded vertices and those at their neighbours, and factor."""
        from scipy import sparse
        from scipy.sparse.linalg import splu

        self._is_occluded, self._factor = is_occluded.copy(), None
        pairs, rest = self._pairs, self._rest
        self._edges = pairs[is_occluded[pairs[:, 0]]]
        if not len(self._edges):
            return
        is_ring = np.zeros(len(rest), bool)
        is_ring[self._edges] = True
        self._ring_edges = pairs[is_ring[pairs[:, 0]]]
        ring, self._ring_starts = np.unique(self._ring_edges[:, 0], return_index=True)
        self._first_ring, self._second_ring = np.searchsorted(ring, self._edges).T
        self._ring_sides = rest[self._ring_edges[:, 0]] - rest[self._ring_edges[:, 1]]
        self._sides = rest[self._edges[:, 0]] - rest[self._edges[:, 1]]
        self._joined, self._starts = np.unique(self._edges[:, 0], return_index=True)
        count = len(self._joined)
        degrees = np.diff(self._starts, append=len(self._edges))
        inner = np.searchsorted(self._joined, self._edges[is_occluded[self._edges[:, 1]]])
        places = np.arange(count)
        entries = np.concatenate([degrees + HOLD_WEIGHT, -np.ones(len(inner))])
        rows, columns = (np.concatenate([places, side]) for side in inner.T)
        matrix = sparse.coo_array((entries, (rows, columns)), shape=(count, count))
        self._factor = splu(matrix.tocsc())
        rows = self._bending[is_occluded]
        held = HOLD_WEIGHT * sparse.eye_array(rows.shape[0])
        self._bend_factor = splu((rows[:, is_occluded] + held).tocsc())
        self._across = rows[:, ~is_occluded]
