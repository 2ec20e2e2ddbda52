"""Clips as scanners and trackers give them: noise, outliers, missing pieces, lost frames, jitter.

Each corruption takes clean frames (F, m, 3) and a seed and returns new ones; lengths are in
diagonals of the first frame. Missing vertices, and all of lost frames, are nan.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cageik_cli.geometry.rotations import nearest_rotations_by_svd

NOISE = 0.003
OUTLIER_SHARE, OUTLIER_LENGTHS = 0.01, (0.05, 0.5)
MISSING_SHARE = 0.2
LOST_SHARE = 0.05
JITTER_SHIFT, JITTER_DEGREES = 0.001, 0.1


@dataclass(frozen=True)
class Corruption:
    """A way to spoil frames."""

    name: str
    apply: Callable[[np.ndarray, np.random.Generator], np.ndarray]


def diagonal_of(frames: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(frames[0], axis=0)))


def add_noise(frames, rng):
    """Independent noise of each vertex, 0.3 % of the diagonal per coordinate."""
    return frames + NOISE * diagonal_of(frames) * rng.standard_normal(frames.shape)


def add_patches(frames, rng):
    """Noise that is alike in patches of the surface: five bumps of 0.5 % in each frame."""
    size, spoilt = diagonal_of(frames), frames.copy()
    for frame in spoilt:
        for _ in range(5):
            centre = frame[rng.integers(len(frame))]
            shape = np.exp(-((np.linalg.norm(frame - centre, axis=1) / (0.05 * size)) ** 2))
            frame += 0.005 * size * shape[:, None] * rng.standard_normal(3)
    return spoilt


def throw_outliers(frames, rng):
    """Throw 1 % of the vertices 5 to 50 % of the diagonal away."""
    spoilt = frames.copy()
    is_out = rng.random(frames.shape[:2]) < OUTLIER_SHARE
    ways = rng.standard_normal((np.count_nonzero(is_out), 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    lengths = rng.uniform(*OUTLIER_LENGTHS, (len(ways), 1)) * diagonal_of(frames)
    spoilt[is_out] += lengths * ways
    return spoilt


def hide_pieces(frames, rng):
    """Hide 20 % of each frame in one piece: the vertices nearest to one of them."""
    spoilt, count = frames.copy(), round(MISSING_SHARE * frames.shape[1])
    known = frames[0]
    for frame in spoilt:
        _, nearest = cKDTree(known).query(known[rng.integers(len(known))], count)
        frame[nearest] = np.nan
    return spoilt


def choose_lost_frames(count, rng):
    """Numbers of 5 % of the frames; never the first, nor the last."""
    return np.sort(rng.choice(np.arange(1, count - 1), max(1, round(LOST_SHARE * count)), False))


def lose_frames(frames, rng):
    """Lose 5 % of the frames."""
    spoilt = frames.copy()
    spoilt[choose_lost_frames(len(frames), rng)] = np.nan
    return spoilt


def add_jitter(frames, rng):
    """Move each frame rigidly: 0.1 % of the diagonal per axis, 0.1 degrees per axis."""
    spoilt = np.empty_like(frames)
    for k, frame in enumerate(frames):
        x, y, z = np.radians(JITTER_DEGREES) * rng.standard_normal(3)
        turn = nearest_rotations_by_svd(np.array([[[1, z, -y], [-z, 1, x], [y, -x, 1]]]))[0]
        centre = np.nanmean(frame, axis=0)
        shift = JITTER_SHIFT * diagonal_of(frames) * rng.standard_normal(3)
        spoilt[k] = (frame - centre) @ turn + centre + shift
    return spoilt


def tear_pieces(frames, rng):
    """Displace 5 % of the vertices in one piece, by 4 % of the diagonal, for 1 to 3 frames each."""
    spoilt, count = frames.copy(), round(0.05 * frames.shape[1])
    left = 0
    for frame in spoilt:
        if not left:
            left = rng.integers(1, 4)
            place = frames[0][rng.integers(len(frame))]
            _, piece = cKDTree(frames[0]).query(place, count)
        way = rng.standard_normal(3)
        frame[piece] += 0.04 * diagonal_of(frames) * way / np.linalg.norm(way)
        left -= 1
    return spoilt


def spoil_all(frames, rng):
    """Everything at once; the first frame, whose diagonal lengths are in, stays clean."""
    first = frames[0]
    for apply in (add_patches, add_noise, throw_outliers, add_jitter, hide_pieces, lose_frames):
        frames = apply(frames, rng)
        frames[0] = first
    return frames


CORRUPTIONS = (
    Corruption("noise", add_noise),
    Corruption("patches", add_patches),
    Corruption("tears", tear_pieces),
    Corruption("outliers", throw_outliers),
    Corruption("missing", hide_pieces),
    Corruption("lost", lose_frames),
    Corruption("jitter", add_jitter),
    Corruption("all", spoil_all),
)


def corrupt(name: str, frames: np.ndarray, seed: int = 0) -> np.ndarray:
    """Spoil frames (F, m, 3) in one of these ways; the first frame, the rest pose, stays clean."""
    one = next(one for one in CORRUPTIONS if one.name == name)
    spoilt = one.apply(frames, np.random.default_rng(seed))
    spoilt[0] = frames[0]
    return spoilt
