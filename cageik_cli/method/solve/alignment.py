"""The best rigid motion of each frame onto the rest pose: a centre, and a rotation about it."""

import numpy as np

from cageik_cli.geometry.points import columns_to_frames
from cageik_cli.geometry.rotations import nearest_rotations_by_svd
from cageik_cli.util import compiled
from cageik_cli.util.arrays import Floats


def centroids(frames: Floats, weights: Floats) -> Floats:
    """Return the mean positions, (k, 3), of frames (k, m, 3) by weights (m,), some above zero."""
    return np.asarray(weights @ frames / weights.sum())


def best_rotations(centred: Floats, rest: Floats, weights: Floats) -> Floats:
    """Return the rotations R that minimise Σ_j weights_j |R v_j − rest_j|², for each frame.

    Parameters
    ----------
    centred : (k, m, 3)
        Frames relative to their weighted centroids.
    rest : (m, 3)
        With its weighted centroid at the origin.
    weights : (m,)
        Not negative.

    Returns
    -------
    (k, 3, 3); `points @ R.T` rotates the points of a frame to the rest pose, `points @ R` back.

    References
    ----------
    Kabsch 1976.
    """
    covariances = (rest * weights[:, None]).T @ centred
    return nearest_rotations_by_svd(covariances)


def best_motions(frames: Floats, rest: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Return the weighted centroids of frames (k, m, 3), (k, 3), and the best rotations about them.

    `rest` and `weights` are as in `best_rotations`.
    """
    if compiled.kernel is None:
        centres = centroids(frames, weights)
        return centres, best_rotations(frames - centres[:, None], rest, weights)
    centres, covariances = np.empty((len(frames), 3)), np.empty((len(frames), 3, 3))
    frames, weights = np.ascontiguousarray(frames), np.ascontiguousarray(weights)
    compiled.kernel.sum_moments(frames, weights, rest, centres, covariances)
    return centres, nearest_rotations_by_svd(covariances)


def move_to_rest(
    frames: Floats, centres: Floats, rotations: Floats, rest: Floats, columns: Floats
) -> None:
    """Fill `columns`, (m, 3k), with R (v − centre) − rest of k frames, (k, m, 3).

    Centres and rotations are those of `best_motions`. Columns have, of each vertex, all frames one
    after the other.
    """
    if compiled.kernel is not None:
        frames, rotations = np.ascontiguousarray(frames), np.ascontiguousarray(rotations)
        compiled.kernel.align_frames(frames, centres, rotations, rest, columns)
        return
    moved = np.matmul(frames - centres[:, None], rotations.swapaxes(1, 2))
    moved -= rest
    columns_to_frames(columns)[...] = moved
