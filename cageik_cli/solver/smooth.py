"""Smooth cages over time, and fill frames and parts of frames without data, by one solve.

For F frames with cages c_t, normal matrices A_t = A − E_t (`solver.robust`) and right sides b_t,

    minimise  Σ_t (c_tᵀ A_t c_t − 2 b_tᵀ c_t)  +  Σ_t γ_t |c_{t−1} − 2 c_t + c_{t+1}|²,

in the frame of the world, so that the acceleration is that which is seen. The rotation of a frame
is only in its Laplacian term, which b_t holds. A frame without data has no term of its own.

Where all A_t are A = U diag(w) Uᵀ, the modes k of A are independent: (w_k I + D₂ᵀ diag(γ) D₂) y_k =
Uᵀ b is a pentadiagonal system over time. Where vertices are missing, this solve is the
preconditioner of conjugate gradients. Long clips are solved in windows that overlap.

It takes two steps. Frames are filled with a fixed strength, and missing vertices are put where
that has them; then all frames are smoothed alike. What is hidden for long stays where each frame's
own solve has it: acceleration alone would let it fly. The strength of the second step is stated as
a period, or found by generalised cross-validation over all residuals (Craven and Wahba 1979; Garcia
2010). γ_t falls where the acceleration is far above its median, so that a hit is not smoothed away.
"""

from dataclasses import dataclass

import numpy as np

from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.util.arrays import Floats, Mask

MAX_CONJUGATE_STEPS = 200
"""Steps of conjugate gradients, at most."""

MAX_BRIDGED_FRAMES = 10
"""Frames in a row for which the motion around them tells where hidden vertices are, at most."""

MIN_WINDOW, MAX_WINDOW = 96, 512
"""Frames per window: as many as have matrices of 64 MiB, within these limits."""

STRENGTHS = 10.0 ** np.arange(-9, 1.01, 0.25)
"""Strengths γ, per mean weight of the vertices, that cross-validation compares."""


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
        than `MAX_BRIDGED_FRAMES` in a row.
    """

    cages: Floats
    is_known: Mask
    lost: dict[int, Floats]


class TimeSmoother:
    """Solver over time of the cages of one binding.

    Parameters
    ----------
    fill_frames : float
        Length in frames, of a motion of the whole mesh, over which missing parts are filled.
    fill_tolerance : float
        Conjugate gradients end at this share of the norm of the noise.
    hit_ratio : float
        Accelerations above so many medians are a hit.

    Attributes
    ----------
    scale : float
        β/n: γ of a length of one frame.
    window, overlap : int
        Frames per window, and by how many it overlaps the next.
    """

    def __init__(
        self,
        solver: DualLaplacianSolver,
        *,
        fill_frames: float = 0.4,
        fill_tolerance: float = 1e-3,
        hit_ratio: float = 4.0,
    ) -> None:
        from scipy.linalg import eigh

        self._fill_frames, self._fill_tolerance = fill_frames, fill_tolerance
        self._hit_ratio = hit_ratio
        self._normal = solver.normal
        self._weights, self._modes = eigh(solver.normal)
        self._vertex_count = len(solver.rest)
        self._data_scale = solver.data_scale
        self.scale = solver.data_scale * self._vertex_count / len(self._weights)
        self.window = int(np.clip((1 << 26) // self._normal.nbytes, MIN_WINDOW, MAX_WINDOW))
        self.overlap = self.window // 4

    def convert_length(self, frames: float) -> float:
        """Return γ for a length in frames.

        A motion of the whole mesh with a period of 2π times that length is halved.
        """
        return float(self.scale * frames**4)

    def fill(self, terms: FrameTerms, noise: float) -> Floats:
        """Return cages, (F, n, 3), whose missing frames and parts follow those around them in time.

        Frames that are whole are as they were. The noise, the mean of the squared residuals of
        vertices in file units, decides when to end.
        """
        known, cages = terms.is_known, terms.cages
        if len(known) < 3 or known.sum() < 2 or (known.all() and not terms.lost):
            return cages
        if not terms.lost:
            length = 0.01  # in frames: between cages that stay as they are
            solved = self._solve_modes(self._normal @ cages, known, self._repeat(length, known))
            return np.where(known[:, None, None], cages, solved)
        right = known[:, None, None] * (self._normal @ cages)
        for t, matrix in terms.lost.items():
            right[t] -= matrix @ cages[t]
        tolerance = self._fill_tolerance**2 * self._data_scale
        end = tolerance * self._vertex_count * noise * len(known)
        gammas = self._repeat(self._fill_frames, known)
        found = self._solve_conjugate(right, known, gammas, terms.lost, end)
        filled = np.where(known[:, None, None], cages, found)
        for t, matrix in terms.lost.items():
            mended = self._modes.T @ (right[t] + matrix @ found[t])
            filled[t] = self._modes @ (mended / self._weights[:, None])
        return filled

    def smooth(self, cages: Floats, is_known: Mask, gamma: float) -> Floats:
        """Return smoothed cages, (F, n, 3), of filled ones; γ falls where a hit is."""
        if len(cages) < 3 or is_known.sum() < 2:
            return cages
        gammas = gamma * self._weigh_accelerations(cages)
        right = is_known[:, None, None] * (self._normal @ cages)
        return self._solve_modes(right, is_known, gammas)

    def measure_validation(self, cages: Floats) -> tuple[Floats, Floats]:
        """Return what smoothing filled cages, (F, n, 3), with each of `STRENGTHS` adds, and leaves.

        Returns
        -------
        added : (s,) float64
            Sum over frames of the squared residuals of vertices, in means over the vertices.
        freedom : (s,) float64
            Number of numbers, per coordinate, that the smoothed cages still have.
        """
        from scipy.linalg import eigh

        second = np.diff(np.eye(len(cages)), 2, axis=0)
        bends, basis = eigh(second.T @ second)
        bends[:2] = 0
        power = ((basis.T @ (self._modes.T @ cages).transpose(1, 0, 2)) ** 2).sum(axis=2)
        added, freedom = [], []
        for strength in STRENGTHS * self.scale:
            ratios = strength / self._weights[:, None] * np.maximum(bends, 0)
            kept = 1 / (1 + ratios)
            added.append((self._weights[:, None] * (1 - kept) ** 2 * power).sum())
            freedom.append(kept.sum())
        to_residuals = 1 / (self._data_scale * self._vertex_count)
        return to_residuals * np.array(added), np.array(freedom)

    def choose_strength(
        self, added: Floats, freedom: Floats, residuals: float, frames: int
    ) -> float:
        """Return the γ of least cross-validation, of the sums over windows.

        `residuals` is the sum over `frames` frames of the mean squared residual of the vertices.
        """
        total = self._vertex_count * frames
        scores = (residuals + added) / (total - freedom) ** 2
        return float(STRENGTHS[int(np.argmin(scores))] * self.scale)

    def _repeat(self, length: float, known: Mask) -> Floats:
        return np.full(len(known) - 2, self.convert_length(length))

    def _weigh_accelerations(self, cages: Floats) -> Floats:
        """Return weights of the accelerations, (F − 2,): 1, and less where one is a hit."""
        bends = np.diff(cages, 2, axis=0)
        sizes = np.sqrt(np.einsum("tix,tix->t", bends, self._normal @ bends))
        middle = self._hit_ratio * np.median(sizes)
        return np.asarray(1 / np.maximum(1, sizes / middle) ** 4) if middle > 0 else sizes + 1

    def _solve_modes(self, right: Floats, is_known: Mask, gammas: Floats) -> Floats:
        """Solve with the same matrix A in all known frames: (F, n, 3)."""
        return _ModeSolver(self._weights, self._modes, is_known, gammas).solve(right)

    def _solve_conjugate(
        self,
        right: Floats,
        is_known: Mask,
        gammas: Floats,
        lost: dict[int, Floats],
        end: float,
    ) -> Floats:
        """Solve with the matrix A − `lost` of each frame; it ends when the error is below `end`."""
        modes = _ModeSolver(self._weights, self._modes, is_known, gammas)

        def multiply(cages: Floats) -> Floats:
            image = is_known[:, None, None] * (self._normal @ cages)
            for t, matrix in lost.items():
                image[t] -= matrix @ cages[t]
            bends = gammas[:, None, None] * np.diff(cages, 2, axis=0)
            image[:-2] += bends
            image[1:-1] -= 2 * bends
            image[2:] += bends
            return np.asarray(image)

        found = modes.solve(right)
        left = right - multiply(found)
        step = modes.solve(left)
        ways, size = step.copy(), (left * step).sum(axis=(0, 1))
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
    """Factors of (w_k o_t I + D₂ᵀ diag(γ) D₂) for all modes k, with o_t = 0 in unknown frames."""

    def __init__(self, weights: Floats, modes: Floats, is_known: Mask, gammas: Floats) -> None:
        from scipy.linalg import cholesky_banded

        self._modes = modes
        bands = np.zeros((3, len(is_known)))
        bands[2, :-2] += gammas
        bands[2, 1:-1] += 4 * gammas
        bands[2, 2:] += gammas
        bands[1, 1:-1] -= 2 * gammas
        bands[1, 2:] -= 2 * gammas
        bands[0, 2:] = gammas
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
