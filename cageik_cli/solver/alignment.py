"""The best rigid motion of each frame onto the rest pose: a centre, and a rotation about it."""

import numpy as np

from cageik_cli.geometry.rotations import nearest_rotations_by_svd
from cageik_cli.util.arrays import Floats


def centroids(frames: Floats, weights: Floats) -> Floats:
    """Return the weighted mean position of each frame, (k, 3).

    Parameters
    ----------
    frames : (k, m, 3)
    weights : (m,)
        Not negative, with a sum above zero.
    """
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
