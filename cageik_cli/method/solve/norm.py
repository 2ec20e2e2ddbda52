"""Cages whose largest deviations are lowered: beyond a limit, deviations count by a higher power.

Least squares leave few vertices far off: the largest deviation of a frame is 5 to 15 times its root
mean square. With the deviations r_j = |v_j − Σ_k H_jk c_k| of a frame, a limit t of `LIMIT_RATIO`
times their root mean square in the cage of least squares, and a norm p above 2, the cage minimises

    (α/n) Σ_i |(L c)_i − δ_i|²  +  (β/m) Σ_j w_j φ(r_j),
    φ(r) = r²  up to t,      t² (1 + (2/p) ((r/t)^p − 1))  above,

which is convex and has a continuous slope. It is the p-norm for what is far off, and least squares
for the rest, so that the root mean square hardly grows. It is found by iteratively reweighted least
squares (Lawson 1961; Burrus 2012): vertex j counts ω_j = max(1, r_j/t)^(p − 2) times. In the
correction d of the cage of least squares, with its residuals e_j and its normal matrix A, a round
solves

    [A + (β/m) Σ_j ((p − 1) ω_j − 1) w_j H_jᵀ H_j] Δd
        = (β/m) Σ_j (ω_j − 1) w_j H_jᵀ (e_j − H_j d) − A d

with sums over the vertices above the limit. The curvature of φ is at most (p − 1) ω_j there, in the
direction of the residual. That damps the steps as Burrus does, who divides them by p − 1: without
it rounds diverge for p above 3. The sums are over a few percent of the vertices, and so is the
price. A frame of which no vertex is above the limit keeps the cage of least squares, to the last
bit.

Skinning has used such norms for the largest error of facial rigs (Compressed Skinning for Facial
Blendshapes, SIGGRAPH 2024).
"""

import numpy as np
from numpy.typing import NDArray

from cageik_cli.util.arrays import Floats, Integers

LIMIT_RATIO = 2.25
"""Limit, in the root mean square of a frame, above which deviations count by a higher power. With
rows of the weights that are fitted in the norm, too, a limit of 2 makes the largest deviation a
tenth smaller than one of 2.5, the error of frames held out 2 to 6 % larger, and takes half as long
again."""

FOLLOWED_RATIO = 0.85
"""Vertices above this share of the limit are followed, as they may come above it in the rounds."""

MIN_LIMIT = 1e-6
"""Smallest limit, in diagonals of the rest pose: nobody sees less, and files round more."""

MAX_CAGE_ROUNDS = 30
"""Rounds of weighing the followed vertices of a frame; p = 6 takes 3 to 7 of them. For p of 9 and
more, rounds may diverge, so that settings end at 8."""

MOVE_TOL = 0.1
"""Rounds end when none moves a followed vertex by more than this share of the limit."""

MAX_SEARCHES = 5
"""Times that all vertices are looked through for others that have come above the limit."""


class DeviationNorm:
    """Corrections that lower the largest deviations of cages of least squares.

    Parameters
    ----------
    norm : float
        p, above 2.
    normal : (n, n) float64
        The normal matrix A of least squares.
    weights : (m, n) float64
        H.
    vertex_weights : (m,) float64
        w, of mean one; vertices of weight 0 are no data.
    data_scale : float
        β/m.
    least : float
        The smallest limit, file units.
    """

    def __init__(
        self,
        norm: float,
        *,
        normal: Floats,
        weights: Floats,
        vertex_weights: Floats,
        data_scale: float,
        least: float,
    ) -> None:
        self._norm, self._least = norm, least
        self._normal, self._weights = normal, weights
        self._counts = data_scale * vertex_weights
        self._shares = vertex_weights / vertex_weights.sum()

    def correct(self, residuals: Floats) -> Floats:
        """Return the corrections, (n, 3k), of cages of least squares with residuals (m, 3k)."""
        squares = self._measure(residuals)
        limits = np.maximum(LIMIT_RATIO * np.sqrt(self._shares @ squares), self._least)
        corrections = np.zeros((self._weights.shape[1], residuals.shape[1]))
        is_followed = np.zeros(squares.shape, bool)
        for _ in range(MAX_SEARCHES):
            is_new = (squares > limits**2) & ~is_followed
            frames = np.flatnonzero(is_new.any(axis=0))
            if not len(frames):
                break
            is_followed[:, frames] |= squares[:, frames] > (FOLLOWED_RATIO * limits[frames]) ** 2
            for k in frames.tolist():
                rows, columns = np.flatnonzero(is_followed[:, k]), slice(3 * k, 3 * k + 3)
                corrections[:, columns] = self._minimize(
                    residuals[rows, columns], rows, corrections[:, columns], limits[k]
                )
            left = self._weights @ corrections
            squares = self._measure(np.subtract(residuals, left, out=left))
        return corrections

    def _measure(self, residuals: Floats) -> Floats:
        """Return the squared deviations, (m, k), of residuals (m, 3k); 0 of what is no data."""
        squares = sum_squares(residuals)
        squares[self._shares == 0] = 0
        return squares

    def _minimize(self, residuals: Floats, rows: Integers, start: Floats, limit: float) -> Floats:
        """Return the best correction, (n, 3), of a frame, from a first guess.

        Parameters
        ----------
        residuals : (c, 3) float64
            Of the followed vertices, in the cage of least squares.
        rows : (c,) int64
            Their numbers.
        """
        weights, counts = self._weights[rows], self._counts[rows]
        correction = start
        left = residuals - weights @ correction
        for _ in range(MAX_CAGE_ROUNDS):
            lengths = np.sqrt(np.einsum("jx,jx->j", left, left))
            above = np.flatnonzero(lengths > limit)
            factors = weigh_deviations(lengths[above], limit, self._norm)
            far = weights[above]
            pull = (counts[above] * (factors - 1))[:, None] * left[above]
            roots = np.sqrt(counts[above] * ((self._norm - 1) * factors - 1))[:, None] * far
            slope = far.T @ pull - self._normal @ correction
            step = np.linalg.solve(self._normal + roots.T @ roots, slope)
            moved = weights @ step
            correction, left = correction + step, left - moved
            if np.abs(moved).max() <= MOVE_TOL * limit:
                break
        return np.asarray(correction)


def weigh_deviations(lengths: Floats, limit: float | Floats, norm: float) -> Floats:
    """Return how many times deviations count in least squares: max(1, length/limit)^(p − 2)."""
    return np.asarray(np.maximum(1.0, lengths / limit) ** (norm - 2))


def sum_squares(columns: NDArray[np.floating]) -> Floats:
    """Return the squared lengths, (m, k), of vectors of k frames, (m, 3k)."""
    squares = np.square(columns, dtype=np.float64)
    return np.asarray(squares[:, 0::3] + squares[:, 1::3] + squares[:, 2::3])
