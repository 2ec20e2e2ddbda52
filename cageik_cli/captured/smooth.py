"""Smooth cages over time: their rigid motion apart, then each vertex of the aligned cages.

A cage is c_t = a_t R_t + o_t, with the mean o_t of its mesh, the rotation R_t of the rest pose to
it, and the aligned cage a_t. So what turns does not shrink, and what trembles as a whole is told
from what deforms. Tracks are o_t, the unit quaternion of R_t, and each vertex of a_t. A track y
becomes the x that minimises

    Σ_t s_t |x_t − y_t|²  +  λ Σ_t h_t |x_{t−1} − 2 x_t + x_{t+1}|².

s_t is the share of the data that the track has in a frame: less where vertices are missing around a
cage vertex, 0 in frames without data. h_t falls where the acceleration is far above its median, so
that a hit is not smoothed away. λ is stated as a period, or found for each track by generalised
cross-validation (Craven and Wahba 1979), for which what trembles alike in many vertices is noise,
too, if it does so in no order over time.
"""

import numpy as np

from cageik_cli.captured.fill import FrameTerms, make_bend_bands
from cageik_cli.geometry.rotations import nearest_rotations_by_svd
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.util.arrays import Floats, Mask

MIN_WINDOW, MAX_WINDOW = 96, 512
"""Frames per window: as many as have matrices of 64 MiB, within these limits."""

STRENGTHS = 10.0 ** np.arange(-2.5, 6.01, 0.25)
"""Strengths λ that cross-validation compares.

The smallest changes the error of a clean dancer by 0.06 %, and still bridges what is occluded for a
frame or two: 1.129 of the clean error against 1.135 with one of 1e-9.
"""

DOUBTFUL_FRAMES = 13
"""Frames that hardly tell noise from quick motion: a share of the square of them per frame.

Scores that differ by a smaller share are equal. So 12 frames of a walk are hardly smoothed, 48 of a
gallop keep 1.01 of their error where the least score itself gives 1.10, and of 175 of a dancer with
patches 1.45 of the error is left, with the least score 1.43.
"""

GAP_STRENGTH = 1e-8
"""Strength λ by which gaps are filled: so small that frames with data hold what is between them."""

MIN_SHARE = 1e-3
"""Smallest share of the data of a cage vertex in a frame with data, so that systems are regular."""

MIN_HIT_RATIO = 4.0
"""Accelerations above so many medians are a hit."""

MIN_ACCELERATION = 1e-6
"""Smallest median acceleration, in sizes of the cage per frame²: below it, it may be rounding."""

MIN_REACH = 7.0
"""Least overlap of windows that are smoothed, in λ^¼ frames.

What is beyond counts less than exp(−7 / √2), which is 0.7 %.
"""


class TimeSmoother:
    """Smoother of the cages of one binding.

    Attributes
    ----------
    window, overlap : int
        Frames per window that is filled, and by how many it overlaps the next.
    """

    def __init__(self, solver: DualLaplacianSolver) -> None:
        weights, vertex_weights = solver.binding.weights, solver.vertex_weights
        self._share_scale = np.diag(solver.normal)
        # The mesh relative to any point will do, as the weighted rest pose sums to zero.
        self._moments = weights.T @ (vertex_weights[:, None] * solver.rest)
        self._mean = vertex_weights @ weights / vertex_weights.sum()
        self.window = int(np.clip((1 << 26) // solver.normal.nbytes, MIN_WINDOW, MAX_WINDOW))
        self.overlap = self.window // 4

    def repeat_period(self, frames: float) -> Floats:
        """Return λ of all tracks, (2 + n,), by which motions of a period in frames are halved."""
        return np.full(2 + len(self._mean), (frames / (2 * np.pi)) ** 4)

    def measure_reach(self, strengths: Floats) -> int:
        """Return by how many frames windows overlap, so that smoothing has no seams."""
        return max(self.overlap, int(np.ceil(MIN_REACH * strengths.max() ** 0.25)))

    def fill(self, cages: Floats, is_known: Mask) -> Floats:
        """Return cages, (F, n, 3), of which frames without data follow those around them.

        What turns between two frames with data turns the shorter way. Frames before the first and
        behind the last of these stay as they are.
        """
        from scipy.linalg import solveh_banded

        known, filled = np.flatnonzero(is_known), cages.copy()
        if len(known) < 2 or len(known) == np.ptp(known) + 1:
            return filled
        inner = np.arange(known[0], known[-1] + 1)
        is_data = is_known[inner]
        # A gap is held until its solve, so that quaternions change their sign from data to data.
        tracks = self._split(cages[np.maximum.accumulate(np.where(is_data, inner, 0))])
        bands = make_bend_bands(np.full(len(inner) - 2, GAP_STRENGTH))
        bands[2] += is_data
        right = is_data[:, None] * tracks.reshape(len(inner), -1)
        solved = solveh_banded(bands, right, check_finite=False).reshape(tracks.shape)
        filled[inner[~is_data]] = _join(solved[~is_data])
        return filled

    def smooth(self, cages: Floats, shares: Floats, strengths: Floats) -> Floats:
        """Return smoothed cages, (F, n, 3), of filled ones.

        Shares of the data are those of `measure_shares`, and λ is per track, (2 + n,).
        """
        from scipy.linalg import solveh_banded

        is_known, smooth = shares[:, 0] > 0, cages.copy()
        known = np.flatnonzero(is_known)
        if len(known) < 3:
            return smooth
        inner = slice(known[0], known[-1] + 1)  # nothing holds what is beyond
        tracks, shares = self._split(cages[inner]), shares[inner]
        weights = weigh_accelerations(tracks, is_known[inner])
        for k, strength in enumerate(strengths):
            bands = make_bend_bands(strength * weights)
            bands[2] += shares[:, k]
            right = shares[:, k, None] * tracks[:, k]
            tracks[:, k] = solveh_banded(bands, right, check_finite=False)
        smooth[inner] = _join(tracks)
        return smooth

    def measure_validation(self, cages: Floats, is_known: Mask) -> tuple[Floats, Floats]:
        """Return what smoothing filled cages, (F, n, 3), with each of `STRENGTHS` takes and leaves.

        Only frames with data count, three of them at least.

        Returns
        -------
        taken : (2 + n, s) float64
            Sum over frames of the squared change of each track.
        freedom : (s,) float64
            Number of numbers, per coordinate, that a smoothed track still has.
        """
        from scipy.linalg import eigh

        # D₂ᵀ D₂ of second differences for the k known frames, (k, k), if others bend least; what is
        # before the first and behind the last one is straight.
        known = np.flatnonzero(is_known)
        second = np.diff(np.eye(known[-1] + 1 - known[0]), 2, axis=0)
        whole, gaps = second.T @ second, np.flatnonzero(~is_known[known[0] : known[-1] + 1])
        known -= known[0]
        across = whole[np.ix_(gaps, known)]
        bent = across.T @ np.linalg.solve(whole[np.ix_(gaps, gaps)], across)
        bends, basis = eigh(whole[np.ix_(known, known)] - bent)
        bends[:2] = 0
        tracks = self._split(cages)[is_known]
        power = ((basis.T @ tracks.transpose(1, 0, 2)) ** 2).sum(axis=2)
        kept = 1 / (1 + np.maximum(bends, 0)[:, None] * STRENGTHS)
        return power @ (1 - kept) ** 2, kept.sum(axis=0)

    def _split(self, cages: Floats) -> Floats:
        """Return the tracks of cages, (F, 2 + n, 4): the centre, the quaternion, aligned vertices.

        What has three coordinates has a zero as the fourth.
        """
        from scipy.spatial.transform import Rotation

        tracks = np.zeros((len(cages), 2 + len(self._mean), 4))
        centres, rotations = self._mean @ cages, nearest_rotations_by_svd(self._moments.T @ cages)
        turns = Rotation.from_matrix(rotations).as_quat()
        signs = np.where((turns[1:] * turns[:-1]).sum(axis=1) < 0, -1.0, 1.0)
        turns[1:] *= np.cumprod(signs)[:, None]
        tracks[:, 0, :3], tracks[:, 1] = centres, turns
        tracks[:, 2:, :3] = (cages - centres[:, None]) @ rotations.swapaxes(1, 2)
        return tracks

    def measure_shares(self, terms: FrameTerms) -> Floats:
        """Return the share of the data that each track has, (F, 2 + n); 0 in unknown frames."""
        shares = np.tile(terms.is_known[:, None], 2 + len(self._mean)).astype(float)
        for t, matrix in terms.lost.items():
            share = 1 - np.diag(matrix) / self._share_scale
            shares[t, 2:] *= np.maximum(share, MIN_SHARE)
        return shares


def choose_strengths(taken: Floats, freedom: Floats, frames: int) -> Floats:
    """Return the λ of least cross-validation of each track, from sums over windows.

    It is the smallest whose score is hardly above the least, for so many `frames` with data: see
    `DOUBTFUL_FRAMES`.
    """
    scores = taken / (frames - freedom) ** 2
    least = (1 + (DOUBTFUL_FRAMES / max(frames, 1)) ** 2) * scores.min(axis=1, keepdims=True)
    return np.asarray(STRENGTHS[(scores <= least).argmax(axis=1)])


def weigh_accelerations(tracks: Floats, is_known: Mask) -> Floats:
    """Return weights of the accelerations of all tracks, (F − 2,): 1, and less around a hit.

    A hit is one of the centre, of the rotation, or of the aligned vertices together; so that of a
    limb, which turns the whole a little, is kept in all of them. A frame that was filled, which
    hardly accelerates, tells neither a hit nor what is usual.
    """
    second = np.diff(tracks, 2, axis=0) ** 2
    weights, is_data = np.ones(len(second)), is_known[1:-1]
    extent = np.sqrt((tracks[is_known, 2:] ** 2).sum(axis=(1, 2)).max())
    for part, size in ((slice(0, 1), extent), (slice(1, 2), 1.0), (slice(2, None), extent)):
        sizes = np.sqrt(second[:, part].sum(axis=(1, 2)))
        usual = MIN_HIT_RATIO * max(np.median(sizes[is_data]), MIN_ACCELERATION * size)
        weights = np.minimum(weights, 1 / np.maximum(1, sizes / usual) ** 4)
    # The acceleration passes through zero within a hit.
    around = np.pad(weights, 1, constant_values=1.0)
    weights = np.minimum(np.minimum(around[:-2], around[2:]), weights)
    return np.where(is_data, weights, 1.0)


def _join(tracks: Floats) -> Floats:
    """Return the cages of tracks."""
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_quat(tracks[:, 1]).as_matrix()
    return np.asarray(tracks[:, 2:, :3] @ turns + tracks[:, :1, :3])
