"""The best rigid motion of every frame onto the rest pose."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.mesh import Floats


@dataclass(frozen=True, slots=True, eq=False)
class RigidMotions:
    """k rotations about k centres that take frames to rest: x ↦ R (x − centre), about the origin.

    Attributes
    ----------
    rotations : (k, 3, 3) float64
    centres : (k, 3) float64
        File units.
    """

    rotations: Floats
    centres: Floats

    def to_rest(self, points: Floats) -> Floats:
        """Move points of the k frames, (k, m, 3), to the rest pose's orientation and the origin."""
        return (points - self.centres[:, None]) @ self.rotations.swapaxes(1, 2)

    def from_rest(self, points: Floats) -> Floats:
        """Move points, (k, m, 3), back to the frames."""
        return points @ self.rotations + self.centres[:, None]


def best_rigid_motions(frames: Floats, rest: Floats, weights: Floats) -> RigidMotions:
    """Minimise Σ_j weights_j |R (v_j − centre) − rest_j|² over rotations R, for every frame.

    Parameters
    ----------
    frames : (k, m, 3)
    rest : (m, 3)
        With its weighted centroid at the origin.
    weights : (m,)
        Not negative, of sum m.

    References
    ----------
    Kabsch 1976; Umeyama 1991 for the sign that keeps reflections out.
    """
    centres = weights @ frames / weights.sum()
    centred = frames - centres[:, None]
    covariances = (rest * weights[:, None]).T @ centred
    left, _, right = np.linalg.svd(covariances)
    left[:, :, 2] *= np.linalg.det(left @ right)[:, None]
    return RigidMotions(left @ right, centres)


def no_motions(count: int, centre: Floats) -> RigidMotions:
    """Motions that turn none of `count` frames, but for the rest pose's own `centre`, (3,)."""
    return RigidMotions(np.tile(np.eye(3), (count, 1, 1)), np.tile(centre, (count, 1)))
