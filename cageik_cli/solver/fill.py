"""Fill parts of frames without data from the frames around them in time, by one solve.

For F frames with cages c_t, normal matrices A_t = A − E_t (`solver.robust`) and right sides b_t,

    minimise  Σ_t (c_tᵀ A_t c_t − 2 b_tᵀ c_t)  +  γ Σ_t |c_{t−1} − 2 c_t + c_{t+1}|²,

in the frame of the world. The rotation of a frame is only in its Laplacian term, which b_t holds. A
frame without data has no term of its own. Missing vertices are then put where that has them. Whole
frames without data are filled by `solver.smooth`.

Where all A_t are A = U diag(w) Uᵀ, the modes k of A are independent: (w_k I + γ D₂ᵀ D₂) y_k =
Uᵀ b is a pentadiagonal system over time. Where vertices are missing, this solve is the
preconditioner of conjugate gradients. What is hidden for long stays where each frame's own solve
has it: acceleration alone would let it fly.
"""

from dataclasses import dataclass

import numpy as np

from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.util.arrays import Floats, Mask

MAX_CONJUGATE_STEPS = 200
"""Steps of conjugate gradients, at most."""

CONJUGATE_TOL = 1e-4
"""Conjugate gradients end at this share of the error of their start, in the norm of the system."""

BRIDGE_LENGTH = 0.37
"""Length in frames: a motion of the whole mesh with a period of 2π times it would be halved."""


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
        than `MAX_BRIDGED_FRAMES` of `solver.summary` in a row.
    """

    cages: Floats
    is_known: Mask
    lost: dict[int, Floats]


class TimeFiller:
    """Solver over time of the cages of one binding, which fills parts without data.

    Parameters
    ----------
    bridge_length : float
        As `BRIDGE_LENGTH`.
    tolerance : float
        As `CONJUGATE_TOL`.
    """

    def __init__(
        self,
        solver: DualLaplacianSolver,
        *,
        bridge_length: float = BRIDGE_LENGTH,
        tolerance: float = CONJUGATE_TOL,
    ) -> None:
        from scipy.linalg import eigh

        self._bridge_length, self._tolerance = bridge_length, tolerance
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
        gamma = self.convert_length(self._bridge_length)
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
