"""Carry a surface along with the poses of the model that it surrounds."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cageik_cli.geometry.points import choose_farthest
from cageik_cli.util.arrays import Floats

MOST_POSES = 8
"""Poses that are looked at, those that differ most."""

NEIGHBOURS = 24
"""Model vertices that a point follows."""

STIFF = 0.01
"""How far the points around may be spread, in diagonals, before they alone decide a rotation."""


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """A model in its rest pose and in others, each moved rigidly onto the rest pose.

    Attributes
    ----------
    rest : (m, 3) float64
    posed : (k, m, 3) float64
    """

    rest: Floats
    posed: Floats

    @staticmethod
    def none() -> "Poses":
        """Return no poses but the rest pose."""
        return Poses(np.zeros((1, 3)), np.zeros((0, 1, 3)))

    def carry(self, points: Floats) -> Floats:
        """Return where points beside the rest pose go in the poses, (k, p, 3).

        Each follows the best rigid motion of the model's vertices near it (Müller et al. 2005).
        """
        count = min(NEIGHBOURS, len(self.rest))
        distance, near = cKDTree(self.rest).query(points, count)
        weight = 1 / (distance.reshape(len(points), -1) + STIFF) ** 2
        weight /= weight.sum(axis=1, keepdims=True)
        near = near.reshape(len(points), -1)
        source = self.rest[near]
        centre = np.einsum("pn,pnx->px", weight, source)
        spread = source - centre[:, None]
        carried = np.empty((len(self.posed), len(points), 3))
        for k, pose in enumerate(self.posed):
            target = pose[near]
            middle = np.einsum("pn,pnx->px", weight, target)
            turn = _best_turns(np.einsum("pn,pnx,pny->pxy", weight, spread, target))
            carried[k] = middle + np.einsum("px,pxy->py", points - centre, turn)
        return carried


def align_poses(rest: Floats, frames: Floats) -> Floats:
    """Return frames (k, m, 3), each moved rigidly onto the rest pose (m, 3)."""
    centre = rest.mean(axis=0)
    centred = frames - frames.mean(axis=1, keepdims=True)
    turns = _best_turns(np.einsum("kmx,my->kxy", centred, rest - centre))
    return np.asarray(np.einsum("kmx,kxy->kmy", centred, turns) + centre)


def choose_poses(rest: Floats, aligned: Floats) -> Poses:
    """Choose the frames that differ most from the rest pose and from each other.

    Parameters
    ----------
    rest : (m, 3)
    aligned : (k, m, 3)
        As `align_poses` returns them.
    """

    def measure(pose: Floats) -> Floats:
        return np.asarray(((aligned - pose) ** 2).sum(axis=(1, 2)))

    count = min(MOST_POSES, len(aligned))
    chosen = choose_farthest(count, measure(rest), lambda k: measure(aligned[k]))
    return Poses(rest, aligned[chosen])


def _best_turns(products: Floats) -> Floats:
    """Return the rotations R with rows x R nearest to y, from Σ xᵀy, (p, 3, 3) (Kabsch 1976)."""
    left, _, right = np.linalg.svd(products)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return np.asarray(left @ right)
